"""Proof that an installation decides as it should, without torch: golden moments, replayed through the real code.

`models/golden.json` and `models/golden.npz` hold a few scenes as the bytes that reach a robot's sockets, and what must
come of them: path lengths and decisions exactly, floats within a tolerance that any processor keeps. What the network
must say was computed in torch, in double precision (`export.golden`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gatar_edge import message
from gatar_edge.agent import Agent, Identity
from gatar_edge.allocators.gatar import Gatar
from gatar_edge.allocators.greedy import Greedy
from gatar_edge.errors import ConfigError
from gatar_edge.manifest import OUTPUTS
from gatar_edge.perception import Perception
from gatar_edge.policy import MODELS
from gatar_edge.scenes import CONFIG, EGO, KEY, inputs_of
from gatar_edge.types import NS_PER_S, Observation, RobotKind
from gatar_edge.view import View

TEXT, ARRAYS = "golden.json", "golden.npz"
FORMAT_VERSION = 1
NOW_NS = 10 * NS_PER_S
FEATURE_TOLERANCE = 1e-5  # exp() and division differ by a few units in the last place between processors
# `gatar verify` holds a file to 1e-5 on the machine that exported it. Another processor sums in another order and may
# double that; a wrong kernel or file is wrong by far more.
OUTPUT_TOLERANCE = 1e-4


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the result."""

    name: str
    ok: bool
    detail: str

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Golden:
    """The golden files of a folder of models."""

    folder: Path
    scenes: list[dict[str, Any]]  # kind, observation (hex), messages (hex), decisions by model
    models: dict[str, str]  # file name -> SHA-256
    arrays: dict[str, Any]  # "0/belief", "0/lengths", "0/features/maps", "0/<model>/scores", ...


def load_golden(folder: Path) -> Golden:
    """Raises ConfigError where the files cannot be used."""
    try:
        text = json.loads((folder / TEXT).read_text())
        with np.load(folder / ARRAYS, allow_pickle=False) as file:
            arrays = dict(file)
        if text["format"] != FORMAT_VERSION:
            raise ConfigError(f"{folder / TEXT}: format {text['format']}, this version reads {FORMAT_VERSION}")
        return Golden(folder, text["scenes"], text["models"], arrays)
    except (OSError, ValueError, KeyError, TypeError) as error:
        cause = (isinstance(error, OSError) and error.strerror) or error
        raise ConfigError(f"no golden vectors in {folder}: {cause}; run `gatar selftest --record`") from None


def selftest(folder: Path = MODELS) -> Iterator[Check]:
    """All checks, one after the other; whatever a check raises is its failure. Raises ConfigError without vectors."""
    golden = load_golden(folder)
    yield _checked("message codec", lambda: _messages(golden))
    yield _checked("path lengths", lambda: _lengths(golden))
    yield _checked("features", lambda: _features(golden))
    for name in sorted({path.name for path in folder.glob("*.onnx")} | set(golden.models)):
        yield _checked(name, lambda: _model(golden, name))  # noqa: B023  # called at once


def robot_of(scene: dict[str, Any], belief: Any, allocator: Any) -> tuple[Agent, Observation]:
    """The robot of a scene, after it heard and saw what the scene says."""
    kind = RobotKind(scene["kind"])
    agent = Agent(Identity(EGO, kind, 1.0), CONFIG, allocator, KEY)
    agent.belief = belief
    for data in scene["messages"]:
        agent.hear(bytes.fromhex(data), NOW_NS)
    observation = Perception(EGO, kind, CONFIG.grid).take(bytes.fromhex(scene["observation"]), NOW_NS, None)
    if observation is None:
        raise ValueError("the observation was not accepted")
    agent.observe(observation)
    return agent, observation


def view_of(golden: Golden, number: int) -> View:
    """What the robot of scene `number` decides on."""
    agent, observation = robot_of(golden.scenes[number], golden.arrays[f"{number}/belief"], Greedy())
    return agent.view(NOW_NS, observation)


def features_key(number: int, looks_ahead: bool) -> str:
    """What the names of a scene's features begin with: models that look ahead have more candidates."""
    return f"{number}/{'ahead' if looks_ahead else 'features'}/"


def decision_of(agent: Agent) -> dict[str, Any]:
    """What is compared of a decision."""
    decision = agent.decide(NOW_NS)
    if decision.fallback:
        raise ValueError(f"decided by {decision.allocator}, because of {decision.fallback}")
    return {
        "choices": list(decision.choices),
        "kind": decision.assignment.kind.name,
        "cell": [int(axis) for axis in decision.assignment.cell],
    }


def sha256(path: Path) -> str:
    """Of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _checked(name: str, check: Callable[[], str]) -> Check:
    try:
        return Check(name, True, check())
    except Exception as error:  # a broken part may raise anything
        return Check(name, False, f"{type(error).__name__}: {error}" if str(error) else type(error).__name__)


def _messages(golden: Golden) -> str:
    """Every message is one that may be believed, and encodes to the same bytes again."""
    count = 0
    for scene in golden.scenes:
        for text in scene["messages"]:
            data = bytes.fromhex(text)
            if message.encode(message.decode(data, KEY), KEY) != data:
                raise ValueError(f"message {count} encodes to other bytes")
            count += 1
    return f"{count} signed messages encode to the same bytes"


def _lengths(golden: Golden) -> str:
    for number in range(len(golden.scenes)):
        view = view_of(golden, number)
        for name in ("targets", "lengths", "hops"):
            if not np.array_equal(getattr(view, name), golden.arrays[f"{number}/{name}"]):
                raise ValueError(f"scene {number}: other {name}")
    return f"equal in {len(golden.scenes)} scenes"


def _features(golden: Golden) -> str:
    worst = 0.0
    for number in range(len(golden.scenes)):
        view = view_of(golden, number)
        for ahead in (False, True):
            for name, array in inputs_of(view, ahead).items():
                key = features_key(number, ahead) + name
                worst = max(worst, _gap(key, array, golden.arrays[key]))
    if worst > FEATURE_TOLERANCE:
        raise ValueError(f"differ by {worst:.1e}, tolerance {FEATURE_TOLERANCE:.0e}")
    return f"largest difference {worst:.1e}, tolerance {FEATURE_TOLERANCE:.0e}"


def _model(golden: Golden, name: str) -> str:
    if name not in golden.models:
        raise ValueError("has no golden vectors: run `gatar selftest --record`")
    if sha256(golden.folder / name) != golden.models[name]:
        raise ValueError("is not the file that the golden vectors were made with")
    allocator = Gatar(golden.folder / name, CONFIG)
    worst = 0.0
    for number, scene in enumerate(golden.scenes):
        prefix = features_key(number, allocator.policy.manifest.looks_ahead)
        inputs = {key.removeprefix(prefix): array for key, array in golden.arrays.items() if key.startswith(prefix)}
        output = allocator.policy.run(inputs)
        for part in OUTPUTS:
            gap = _gap(f"scene {number}, {part}", getattr(output, part), golden.arrays[f"{number}/{name}/{part}"])
            worst = max(worst, gap)
        agent, _ = robot_of(scene, golden.arrays[f"{number}/belief"], allocator)
        decided, expected = decision_of(agent), scene["decisions"][name]
        if decided != expected:
            raise ValueError(f"scene {number}: decides {decided}, expected {expected}")
    if worst > OUTPUT_TOLERANCE:
        raise ValueError(f"output differs by {worst:.1e}, tolerance {OUTPUT_TOLERANCE:.0e}")
    return (
        f"decides alike in {len(golden.scenes)} scenes, largest difference {worst:.1e}, "
        f"tolerance {OUTPUT_TOLERANCE:.0e}"
    )


def _gap(where: str, ours: Any, theirs: Any) -> float:
    if ours.shape != theirs.shape:
        raise ValueError(f"{where}: shape {ours.shape}, expected {theirs.shape}")
    return float(np.abs(ours.astype(np.float64) - theirs).max(initial=0.0))
