"""What a run folder keeps from the first moment on: whose run it is, and the exact state that it goes on from.

The state of a network and its optimizer is one file of safetensors, written whole or not at all.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from gatar_edge.errors import ConfigError

FILE = "checkpoint.safetensors"
NOTE = "run.json"


def claim(folder: Path, wanted: dict[str, Any], *, writes: bool = True) -> None:
    """Start a folder for the run that `wanted` describes, or find that it is this run's. Raises ConfigError.

    What the run reads is known in `wanted` by its digest, not by where it lies: it may be moved.
    """
    folder.mkdir(parents=True, exist_ok=True)
    note = folder / NOTE
    wanted = json.loads(json.dumps(wanted))
    if note.is_file() and json.loads(note.read_text()) != wanted:
        raise ConfigError(f"{folder} holds another run (see {note.name}): choose another folder")
    if writes:
        new = note.with_suffix(".new")
        new.write_text(json.dumps(wanted, indent=1) + "\n")
        new.replace(note)


def save_checkpoint(
    folder: Path, network: nn.Module, optimizer: torch.optim.Optimizer, note: dict[str, Any],
    more: Mapping[str, Tensor] | None = None,
) -> None:  # fmt: skip
    """Write the state of `folder`'s run; `note` is plain values, `more` tensors with names of their own."""
    state = {f"model.{name}": tensor for name, tensor in network.state_dict().items()}
    for name, parameter in network.named_parameters():
        for key, value in optimizer.state.get(parameter, {}).items():
            state[f"{key}.{name}"] = torch.as_tensor(value)
    state |= {f"more.{name}": tensor for name, tensor in (more or {}).items()}
    new = folder / "checkpoint.new"
    save_file(state, new, metadata={"state": json.dumps(note)})
    new.replace(folder / FILE)


def load_checkpoint(
    folder: Path, network: nn.Module, optimizer: torch.optim.Optimizer, device: str
) -> tuple[dict[str, Any], dict[str, Tensor]] | None:
    """Set network and optimizer as they were; the note and the further tensors, or None where nothing was saved.

    Raises ConfigError where the file is damaged: what to lose is for its owner to say.
    """
    path = folder / FILE
    if not path.is_file():
        return None
    try:
        state = load_file(path, device=device)
        with safe_open(path, framework="pt") as file:
            note: dict[str, Any] = json.loads(file.metadata()["state"])
    except SafetensorError as error:
        raise ConfigError(f"{path} is damaged ({error}): remove it to begin this run anew") from None
    network.load_state_dict({name[6:]: value for name, value in state.items() if name.startswith("model.")})
    for name, parameter in network.named_parameters():
        optimizer.state[parameter] = {
            key: state[f"{key}.{name}"] for key in ("step", "exp_avg", "exp_avg_sq") if f"{key}.{name}" in state
        }
    return note, {name[5:]: value for name, value in state.items() if name.startswith("more.")}
