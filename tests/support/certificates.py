"""Certificates for a test, made by the openssl command: authorities, and what they sign."""

from __future__ import annotations

import subprocess
from pathlib import Path

_KEY = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")


def authority(folder: Path, name: str) -> Path:
    """A certificate that signs others; its key lies beside it."""
    made = folder / f"{name}.pem"
    _openssl("req", "-x509", *_KEY, "-days", "2", "-subj", f"/CN={name}", "-keyout", f"{made}.key", "-out", str(made))
    return made


def signed_by(issuer: Path, name: str) -> Path:
    """A certificate of 127.0.0.1 and localhost, signed by `issuer`; its key lies beside it."""
    made = issuer.with_name(f"{name}.pem")
    names = ("-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1")
    _openssl("req", "-new", *_KEY, "-subj", f"/CN={name}", *names, "-keyout", f"{made}.key", "-out", f"{made}.csr")
    by = ("-CA", str(issuer), "-CAkey", f"{issuer}.key", "-CAcreateserial")
    _openssl("x509", "-req", "-in", f"{made}.csr", *by, "-days", "2", "-copy_extensions", "copy", "-out", str(made))
    return made


def _openssl(*arguments: str) -> None:
    subprocess.run(["openssl", *arguments], check=True, capture_output=True)
