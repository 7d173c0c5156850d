"""The team's key: 32 secret bytes that every robot of a team holds and nobody else. It is never logged or printed."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path

from gatar_edge.errors import ConfigError

KEY_BYTES = 32

# For simulations and examples only: everybody can read it here, so a radio that uses it is open to everybody.
DEMO_KEY = hashlib.blake2b(b"gatar-edge demonstration key, public", digest_size=KEY_BYTES).digest()


def read_key(path: Path) -> bytes:
    """The 32-byte key in `path`, stored raw or as 64 hexadecimal digits.

    Raises ConfigError, naming the path and the mend, where the file is missing, readable by others, or not a key.
    """
    try:
        # not blocking: a pipe in the key's place must not hang the robot
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise ConfigError(
            f"key file {path} cannot be read ({error.strerror}): make one with "
            f"`(umask 077; head -c {KEY_BYTES} /dev/urandom > {path})` and copy it to each robot of the team"
        ) from error
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise ConfigError(f"key file {path} is not a file: name the file that holds the team's key")
        if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
            raise ConfigError(
                f"key file {path} has mode {stat.S_IMODE(status.st_mode):04o}, so others may use it: chmod 600 {path}"
            )
        return _parse_key(os.read(descriptor, 4 * KEY_BYTES), path)
    finally:
        os.close(descriptor)


def _parse_key(content: bytes, path: Path) -> bytes:
    if len(content) == KEY_BYTES:
        return content
    digits = content.strip()
    try:
        key = bytes.fromhex(digits.decode("ascii")) if len(digits) == 2 * KEY_BYTES else b""
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise ConfigError(
            f"key file {path} does not hold {KEY_BYTES} raw bytes or {2 * KEY_BYTES} hexadecimal digits: make one with "
            f"`head -c {KEY_BYTES} /dev/urandom > {path}`"
        ) from None
    return key
