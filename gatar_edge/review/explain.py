"""Why a robot did what it did, in words and as data, from one recorded decision and the one before it.

Works on decisions as the log holds them (JSON objects with the fields of `types.Decision`), so that a decision of
another allocator or an older program is explained as well.
"""

from __future__ import annotations

from typing import Any

from gatar_edge.review.company import Json, absent_line, absent_of, cell_text, neighbor_line, neighbors_of
from gatar_edge.types import RobotKind, TaskKind

NOBODY = -1

_REASONS = {
    "allocated": "The {allocator} allocator gave it this target now.",
    "kept": "It keeps its task: the target is still open, reachable, and claimed by nobody who is nearer.",
    "abandoned": "It has nothing else to do, and nobody that it hears is on the way to this target.",
    "frontier": "No open target is left for it, so it goes to see the nearest unknown cell that nobody else covers.",
    "nothing_left": "No target and nothing reachable to look at is left, so it stays where it is.",
    "no_vehicle": "Its vehicle cannot be commanded: not started, link or position lost, or the pilot has taken over.",
    "no_perception": "Its own perception is missing or too old, so it stays where it is.",
}

_STANDING = frozenset(("no_perception", "no_vehicle"))


def explain(decision: Json, previous: Json | None, record: Json | None = None) -> Json:
    """Everything about one decision: what it knew, whom it heard, the candidates, and why this one. See `words`."""
    candidates = _candidates(decision)
    return {
        "robot_id": decision["robot_id"],
        "tick": decision["tick"],
        "t_ns": decision["t_ns"],
        "headline": headline(decision),
        "why": why(decision, previous, candidates),
        "assignment": decision["assignment"],
        "allocator": decision["allocator"],
        "fallback": decision["fallback"],
        "retask": decision["retask"],
        "neighbors": neighbors_of(decision),
        "absent": absent_of(decision),
        "candidates": candidates,
        "wanted": (record or {}).get("wanted"),
        "sent": (record or {}).get("sent"),
        "latency_ns": decision["latency_ns"],
    }


def words(explanation: Json) -> list[str]:
    """The explanation as lines of text."""
    lines = [explanation["headline"], *(f"  {line}" for line in explanation["why"])]
    if explanation["assignment"]["reason"] in _STANDING:  # decided without a look at anybody
        return lines
    neighbors = explanation["neighbors"]
    lines.append(f"It heard {_count(len(neighbors), 'robot')}:" if neighbors else "It heard nobody.")
    lines.extend(f"  {neighbor_line(neighbor)}" for neighbor in neighbors)
    if explanation["absent"]:
        lines.append(f"It reckoned with {_count(len(explanation['absent']), 'robot')} out of range:")
        lines.extend(f"  {absent_line(robot)}" for robot in explanation["absent"])
    candidates = explanation["candidates"]
    if candidates:
        lines.append(f"It knew {_count(len(candidates), 'open target')}, nearest first:")
        lines.extend(f"  {_candidate_line(candidate)}" for candidate in candidates)
    if explanation["wanted"] is not None:
        lines.append(_command_line(explanation["wanted"], explanation["sent"]))
    lines.append(f"Decided by {explanation['allocator']} in {explanation['latency_ns'] / 1e6:.2f} ms.")
    return lines


def headline(decision: Json) -> str:
    """One sentence: who does what."""
    assignment = decision["assignment"]
    match TaskKind(assignment["kind"]):
        case TaskKind.TARGET:
            does = f"goes for the target at {cell_text(assignment['cell'])}, {_way(decision)}"
        case TaskKind.EXPLORE:
            does = f"explores towards {cell_text(assignment['cell'])}, {_way(decision)}"
        case TaskKind.HOLD:
            does = "holds"
    return f"{_name(decision)} at {cell_text(decision['cell'])} {does}."


def why(decision: Json, previous: Json | None, candidates: list[Json]) -> list[str]:
    """The reasons, the most telling first."""
    assignment = decision["assignment"]
    lines = [_reason(decision, candidates)]
    if decision["fallback"]:
        lines.insert(
            0, f"The configured allocator failed ({decision['fallback']}), so {decision['allocator']} decided."
        )
    if previous is not None and previous["assignment"]["cell"] != assignment["cell"]:
        lines.extend(_change(decision, previous))
    chosen = _chosen(decision, candidates)
    lines.extend(_taken_offer(decision, candidates))
    if chosen is not None:
        lines.append(_rank(chosen, candidates))
    nearest = next((c for c in candidates if c["length"] >= 0), None)
    if chosen is not None and nearest is not None and nearest["length"] == chosen["length"]:
        return lines
    if nearest is not None and nearest is not chosen and TaskKind(assignment["kind"]) is not TaskKind.HOLD:
        lines.append(_why_not(nearest, decision))
    return lines


def _candidates(decision: Json) -> list[Json]:
    """Known open targets, nearest first, with who gets each in the joint solution and who claims it already."""
    robots = decision["robots"]
    planned = [*robots, *decision.get("absent", ())]
    choices = [*decision["choices"], *decision.get("kept_for_absent", ())]
    given = {choice: planned[row]["robot_id"] for row, choice in enumerate(choices) if choice >= 0}
    claims: dict[tuple[int, ...], int] = {}
    for robot in robots[1:]:
        if robot["task"] == TaskKind.TARGET:
            claims.setdefault(tuple(robot["task_cell"]), robot["robot_id"])
    found = [
        {
            "cell": candidate["cell"],
            "length": candidate["length"],
            "score": candidate["score"],
            "given_to": given.get(index, NOBODY),
            "claimed_by": claims.get(tuple(candidate["cell"]), NOBODY),
            "chosen": _is_goal(decision, candidate["cell"]),
        }
        for index, candidate in enumerate(decision["candidates"])
    ]
    return sorted(found, key=lambda c: (c["length"] < 0, c["length"], c["cell"]))


def _is_goal(decision: Json, cell: Any) -> bool:
    assignment = decision["assignment"]
    return bool(assignment["kind"] == TaskKind.TARGET and list(assignment["cell"]) == list(cell))


def _chosen(decision: Json, candidates: list[Json]) -> Json | None:
    return next((candidate for candidate in candidates if candidate["chosen"]), None)


def _change(decision: Json, previous: Json) -> list[str]:
    """What became of the task before."""
    task = previous["assignment"]
    where = cell_text(task["cell"])
    match TaskKind(task["kind"]):
        case TaskKind.HOLD:
            return []
        case TaskKind.EXPLORE:
            return [f"Before, it was exploring towards {where}."]
        case TaskKind.TARGET if list(task["cell"]) == list(decision["cell"]):
            return [f"It has just reached its target at {where}."]
        case TaskKind.TARGET:
            return [_given_up(decision, task["cell"])]


def _given_up(decision: Json, cell: Any) -> str:
    where = cell_text(cell)
    still_open = next((c for c in _candidates(decision) if list(c["cell"]) == list(cell)), None)
    if still_open is None:
        return f"Its target before, {where}, is not open any more: somebody has localized it, or it was no target."
    if still_open["length"] < 0:
        return f"It gave up {where}, which it cannot reach any more."
    if still_open["claimed_by"] != NOBODY:
        return f"It gave up {where}: robot {still_open['claimed_by']} is on its way there and nearer in time."
    if still_open["given_to"] not in (NOBODY, decision["robot_id"]):
        return f"It gave up {where}: the joint solution now gives it to robot {still_open['given_to']}."
    return f"It gave up {where} for this."


def _reason(decision: Json, candidates: list[Json]) -> str:
    reason = decision["assignment"]["reason"]
    if reason == "kept" and decision.get("steady"):
        return _kept_by_steady(decision, candidates)
    if reason == "frontier":
        free = sum(c["length"] >= 0 and c["given_to"] == c["claimed_by"] == NOBODY for c in candidates)
        if _looks_where_told(decision):
            rather = f", rather than for {_count(free, 'open target')} that nobody claims" if free else ""
            return f"The {decision['allocator']} allocator chose this place for it to go and look{rather}."
        if free:
            none = f"The {decision['allocator']} allocator gave it none of {_count(free, 'open target')}"
            return f"{none} that nobody claims, so it goes to see the nearest unknown cell that nobody else covers."
    return str(_REASONS.get(reason, reason)).format(allocator=decision["allocator"])


def _kept_by_steady(decision: Json, candidates: list[Json]) -> str:
    """An allocator that is steady chooses anew at every step, and mostly the same."""
    chosen = _chosen(decision, candidates)
    if chosen is not None and chosen["given_to"] == decision["robot_id"]:
        return f"The {decision['allocator']} allocator chooses anew at every step, and chose the same target again."
    stays = "It stays with its target though the allocator now chose otherwise"
    return f"{stays}: what it chose is taken, or the robot has changed its mind too often to do so again."


def _looks_where_told(decision: Json) -> bool:
    told = decision.get("frontier")
    return told is not None and list(told) == list(decision["assignment"]["cell"])


def _taken_offer(decision: Json, candidates: list[Json]) -> list[str]:
    """The joint solution's own offer to this robot, where somebody else was on the way there already."""
    offer = next((c for c in candidates if c["given_to"] == decision["robot_id"]), None)
    if offer is None or offer["chosen"] or offer["claimed_by"] == NOBODY:
        return []
    if decision["assignment"]["reason"] == "kept" and not decision.get("steady"):
        return []
    robot = f"robot {offer['claimed_by']}"
    return [f"The joint solution offers it {cell_text(offer['cell'])}, but {robot} is already on its way there."]


def _rank(chosen: Json, candidates: list[Json]) -> str:
    nearer = sum(0 <= c["length"] < chosen["length"] for c in candidates)
    if nearer == 0:
        return f"No open target that it knows is nearer than this one ({_count(chosen['length'], 'cell')})."
    are = "one is" if nearer == 1 else f"{nearer} are"
    way = _count(chosen["length"], "cell")
    return f"Of the {len(candidates)} open targets it knows, {are} nearer than this one ({way})."


def _why_not(nearest: Json, decision: Json) -> str:
    where = f"Not the nearest, {cell_text(nearest['cell'])} at {_count(nearest['length'], 'cell')}"
    if nearest["claimed_by"] != NOBODY:
        return f"{where}: robot {nearest['claimed_by']} is already on its way there."
    if nearest["given_to"] not in (NOBODY, decision["robot_id"]):
        return f"{where}: the joint solution gives it to robot {nearest['given_to']}."
    if decision["assignment"]["reason"] == "frontier" and _looks_where_told(decision):
        return f"{where}: the allocator, which scores it {_score(nearest)}, weighs targets and places to look together."
    if decision["assignment"]["reason"] == "kept" and decision.get("steady"):
        return f"{where} and score {_score(nearest)}: what a robot is on its way to counts for more."
    if decision["assignment"]["reason"] == "kept":
        return f"{where}: a task is not reconsidered before it ends."
    return f"{where}: the allocator scores it lower ({_score(nearest)})."


def _candidate_line(candidate: Json) -> str:
    marks = []
    if candidate["chosen"]:
        marks.append("chosen")
    if candidate["given_to"] != NOBODY:
        marks.append(f"joint solution: robot {candidate['given_to']}")
    if candidate["claimed_by"] != NOBODY:
        marks.append(f"claimed by robot {candidate['claimed_by']}")
    length = _count(candidate["length"], "cell") if candidate["length"] >= 0 else "unreachable"
    notes = f" [{'; '.join(marks)}]" if marks else ""
    return f"{cell_text(candidate['cell'])}: {length}, score {_score(candidate)}{notes}"


def _command_line(wanted: Json, sent: Json | None) -> str:
    if sent is None or sent == wanted:
        return f"The vehicle was told: {_command(wanted)}."
    return f"It wanted {_command(wanted)}; the safety gate let through {_command(sent)}."


def _command(command: Json) -> str:
    match command.get("type"):
        case "goto":
            return f"go to {cell_text(command['cell'])}"
        case "mission":
            corners = len(command["cells"]) - 1
            way = f", round {_count(corners, 'corner')}" if corners else ""
            return f"drive to {cell_text(command['cells'][-1])}{way}"
        case _:
            return f"hold ({command.get('reason', '')})"


def _score(candidate: Json) -> str:
    return "none" if candidate["score"] is None else f"{candidate['score']:.3g}"


def _way(decision: Json) -> str:
    """From where it is: a path that stays good begins where the task was taken."""
    path, here = decision["assignment"]["path"], decision["cell"]
    gone = path.index(here) if here in path else 0
    return f"{_count(max(0, len(path) - 1 - gone), 'cell')} away"


def _name(decision: Json) -> str:
    kind = RobotKind(decision["robots"][0]["kind"]).name if decision["robots"] else "Robot"
    return f"{kind} {decision['robot_id']}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
