"""torch -> one ONNX file with its weights and its contract inside."""

from __future__ import annotations

import json
import logging
import shutil
import subprocess
import warnings
from pathlib import Path
from typing import Any

import onnx
import torch

from gatar_edge import manifest as contract
from gatar_edge.errors import ConfigError, ModelError
from gatar_edge.export.spec import EXAMPLE, IR_VERSION, OPSET, SingleView, dynamic_shapes
from gatar_edge.export.states import random_state
from gatar_edge.learn.train import load_model


def export(run: Path, out: Path) -> dict[str, Any]:
    """Write `out` (.onnx) and its weights beside it (.safetensors) from a finished run; returns the contract.

    Raises ConfigError where the run is not finished, or `out` has another ending: it could be that of the weights.
    """
    if out.suffix != ".onnx":
        raise ConfigError(f"{out}: a model's name ends in .onnx, its weights lie beside it in .safetensors")
    network, description = load_model(run)
    inputs: tuple[str, ...] = network.inputs  # type: ignore[assignment]
    example = random_state(EXAMPLE["N"], EXAMPLE["M"], seed=0, r_comm=6.0)
    tensors = tuple(torch.from_numpy(example[name]) for name in inputs)
    model = _converted(SingleView(network).eval(), inputs, tensors)
    fields = contract_of(out.stem, description, inputs)
    _clean(model)
    model.ir_version = IR_VERSION
    onnx.helper.set_model_props(model, {contract.KEY: json.dumps(fields, sort_keys=True)})
    onnx.checker.check_model(model)
    out.parent.mkdir(parents=True, exist_ok=True)
    weights = out.with_suffix(".safetensors")
    if not (weights.exists() and weights.samefile(run / "model.safetensors")):  # as for RUN/model.onnx
        shutil.copyfile(run / "model.safetensors", weights)
    onnx.save_model(model, out)
    return fields


def _converted(network: SingleView, inputs: tuple[str, ...], tensors: tuple[torch.Tensor, ...]) -> onnx.ModelProto:
    """Two steps: the one-step form ignores violated constraints and makes a model of fixed size without a word."""
    shapes = dynamic_shapes(inputs)
    for name in ("torch.onnx", "onnxscript"):  # they warn of packages that are not there, and of what they leave as is
        logging.getLogger(name).setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of torch's own deprecations; the file is proved by `verify`
        program = torch.export.export(network, tensors, dynamic_shapes=shapes)
        converted = torch.onnx.export(
            program, tensors, dynamo=True, opset_version=OPSET, external_data=False, verbose=False,
            input_names=list(inputs), output_names=list(contract.OUTPUTS), dynamic_shapes=shapes,
        )  # fmt: skip
    if converted is None:
        raise ModelError("torch.onnx.export gave no program")
    model: onnx.ModelProto = converted.model_proto
    return model


def contract_of(name: str, description: dict[str, Any], inputs: tuple[str, ...]) -> dict[str, Any]:
    """Everything that the loader checks, and where the model comes from."""
    options = description["data"]["options"]
    train = dict(description["train"])
    train.pop("data")  # a path of the machine that trained
    return {
        **contract.fixed_fields(),
        "name": name,
        "inputs": contract.input_fields(inputs),
        "levels": options["hop_limit"],
        "r_sense": [min(options["r_senses"]), max(options["r_senses"])],
        "r_comm": [min(options["r_comms"]), max(options["r_comms"])],
        "opset": OPSET,
        "git_revision": _revision(),
        "network": description["network"],
        "settings": description["settings"],
        "parameters": description["parameters"],
        "training": {
            "data_sha256": description["data"]["sha256"],
            "data": options,
            "steps": description["steps"],
            **train,
        },
    }


def _clean(model: Any) -> None:
    """Take out what tells of the machine that exported: source paths and stack traces."""
    model.producer_name, model.producer_version, model.doc_string = "gatar-edge", "", ""
    graphs = [model.graph, *model.functions]
    for graph in graphs:
        graph.doc_string = ""
        del graph.metadata_props[:]
        for node in graph.node:
            node.doc_string = ""
            del node.metadata_props[:]
    for value in [*model.graph.value_info, *model.graph.input, *model.graph.output, *model.graph.initializer]:
        value.doc_string = ""
        del value.metadata_props[:]


def _revision() -> str:
    """The commit that the exporting code stands on, or "unknown" outside a repository."""
    here = Path(__file__).resolve().parent
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12"],
            cwd=here,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()
