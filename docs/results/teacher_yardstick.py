"""How good the routing rule's tours are, against OR-Tools with seconds to think.

OR-Tools pins a protobuf that clashes with onnx's, so it runs in an environment of its own:

    python docs/results/teacher_yardstick.py problems > problems.jsonl       (here, with numba)
    OTHER/bin/python docs/results/teacher_yardstick.py solve problems.jsonl  (where `pip install ortools` was run)

Problems are whole worlds of the validation seeds with everything known. Cost as in `allocators.tours`: sum of arrival
times + 5 x the last one, in seconds.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from typing import Any

TEAMS = ("1A1G", "3A3G", "6A6G")
WORLDS = 12
FIRST_SEED = 1_002_000
ROUNDS = (0, 100, 400, 20_000)  # 100 on a robot
THINK_S = 10
SCALE = 100  # OR-Tools counts in whole numbers
FAR = 10**7


def problems() -> None:
    """Print one problem a line, with what our rule makes of it."""
    import numpy as np

    from gatar_edge.allocators.routing import problem_of
    from gatar_edge.learn.compiled import compiled_tours, empty_plan
    from gatar_edge.sim_sitl.world import Team, random_world
    from gatar_edge.types import CellState, RobotState
    from gatar_edge.view import build_view

    solve_tours = compiled_tours().solve
    for team in TEAMS:
        for seed in range(FIRST_SEED, FIRST_SEED + WORLDS):
            world = random_world(Team.parse(team), None, 15, 15, seed)
            belief = np.where(world.obstacles, CellState.OBSTACLE, CellState.FREE).astype(np.uint8)
            belief[tuple(world.targets.T)] = CellState.TARGET
            robots = [
                RobotState(robot_id, kind, cell, 1.0)
                for robot_id, kind, cell in zip(world.team.ids, world.team.kinds, world.starts, strict=True)
            ]
            problem = problem_of(build_view(0, robots[0], robots[1:], belief, 6.0, 2, 64))
            first, legs = (np.where(np.isfinite(a), a, -1).tolist() for a in (problem.first, problem.legs))
            costs = {rounds: solve_tours(problem, empty_plan(*problem.first.shape), rounds) for rounds in ROUNDS}
            print(
                json.dumps(
                    {"team": team, "first": first, "legs": legs, "kinds": problem.kinds.tolist(), "costs": costs}
                )
            )


def solve(path: str) -> None:
    """Print, per team, the mean cost of OR-Tools and how much dearer our rule is."""
    rows: dict[str, list[dict[str, float]]] = defaultdict(list)
    with open(path) as file:
        for line in file:
            problem = json.loads(line)
            rows[problem["team"]].append({**problem["costs"], "ortools": _ortools_cost(problem)})
    for team, costs in rows.items():
        best = sum(row["ortools"] for row in costs)
        dearer = ", ".join(f"{r} rounds {sum(row[str(r)] for row in costs) / best - 1:+.1%}" for r in ROUNDS)
        print(f"{team}: OR-Tools {THINK_S} s {best / len(costs):.1f} s; ours with {dearer}")


def _ortools_cost(problem: dict[str, Any]) -> float:
    from ortools.constraint_solver import pywrapcp, routing_enums_pb2

    first, legs, kinds = problem["first"], problem["legs"], problem["kinds"]
    robots, targets = len(first), len(first[0])
    start, end = targets, targets + robots  # places after the targets
    manager = pywrapcp.RoutingIndexManager(targets + robots + 1, robots, list(range(start, end)), [end] * robots)
    model = pywrapcp.RoutingModel(manager)

    def length(robot: int, here: int, there: int) -> int:
        if there == end:
            return 0  # tours are open
        cells = (
            first[robot][there] if here == start + robot else -1 if here >= start else legs[kinds[robot]][here][there]
        )
        return round(cells * SCALE) if cells >= 0 else FAR

    transits = [
        model.RegisterTransitCallback(
            lambda a, b, robot=robot: length(robot, manager.IndexToNode(a), manager.IndexToNode(b))
        )
        for robot in range(robots)
    ]
    model.AddDimensionWithVehicleTransits(transits, 0, 2 * FAR, True, "time")
    time = model.GetDimensionOrDie("time")
    time.SetGlobalSpanCostCoefficient(5)
    reachable = [t for t in range(targets) if any(first[robot][t] >= 0 for robot in range(robots))]
    for target in range(targets):
        index = manager.NodeToIndex(target)
        if target in reachable:
            time.SetCumulVarSoftUpperBound(index, 0, 1)
        else:
            model.AddDisjunction([index], 0)
    search = pywrapcp.DefaultRoutingSearchParameters()
    search.first_solution_strategy = routing_enums_pb2.FirstSolutionStrategy.PARALLEL_CHEAPEST_INSERTION
    search.local_search_metaheuristic = routing_enums_pb2.LocalSearchMetaheuristic.GUIDED_LOCAL_SEARCH
    search.time_limit.seconds = THINK_S
    solution = model.SolveWithParameters(search)
    return float(solution.ObjectiveValue()) / SCALE


if __name__ == "__main__":
    problems() if sys.argv[1:] == ["problems"] else solve(sys.argv[2])
