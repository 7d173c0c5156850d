"""Tours of a whole mixed team over all known targets: cheapest insertion, then taking out and inserting again.

Cost of a plan = sum of all arrival times + `MAKESPAN_WEIGHT` x the latest arrival; tours are open; a target that no
robot can reach is in no tour. The search draws from its own generator: the same problem gives the same plan everywhere.

Rule: plain loops over `a[i][j]`, calls within this file, no library. So the functions run on lists on a robot, and
compiled on arrays where thousands of plans are wanted (`learn.compiled`), with the same result to the last bit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

MAKESPAN_WEIGHT = 5.0
ROUNDS = 100  # of the local search; twenty times as many make better plans, but no shorter missions
MOST_REMOVED = 4  # targets taken out in one round

INF = float("inf")

Numbers = Any  # sequence of numbers: a list, or an array when compiled
Rows = Any  # sequence of such sequences


class Problem(NamedTuple):
    """N robots, M targets; seconds, inf where there is no way."""

    first: Rows  # [N][M] from each robot to each target
    legs: Rows  # [kind][M][M] cells from target to target
    kinds: Numbers  # [N]
    pace: Numbers  # [N] seconds a cell


class Plan(NamedTuple):
    """The tours, changed in place. `kept` is where the search goes back to."""

    tour: Rows  # [N][M] targets in the order of visits, the first `count` of each row
    count: Numbers  # [N]
    sums: Numbers  # [N] arrival times added up
    ends: Numbers  # [N] last arrival
    kept: Rows  # [N][M]
    kept_count: Numbers  # [N]
    removed: Numbers  # [M] targets in no tour, scratch


def solve(problem: Problem, plan: Plan, rounds: int) -> float:
    """Fill the empty `plan` and improve it for `rounds` rounds; the cost reached."""
    robots, targets = len(problem.kinds), len(problem.legs[0])
    for target in range(targets):
        plan.removed[target] = target
    planned = targets - insert_all(problem, plan, targets)
    best = cost_of(plan, robots)
    keep(plan, robots)
    luck = 1
    for _ in range(rounds if planned > 1 else 0):
        removals = 1 + (luck >> 8) % MOST_REMOVED
        for place in range(min(removals, planned)):
            luck = (luck * 1103515245 + 12345) & 0x7FFFFFFF  # the C standard's example generator
            plan.removed[place] = take_out(problem, plan, (luck >> 8) % (planned - place))
        insert_all(problem, plan, min(removals, planned))
        cost = cost_of(plan, robots)
        if cost <= best:
            best = cost
            keep(plan, robots)
        else:
            undo(problem, plan, robots)
    return best


def insert_all(problem: Problem, plan: Plan, waiting: int) -> int:
    """Put the first `waiting` targets of `removed` into tours, always the cheapest one next; how many found no way."""
    robots = len(problem.kinds)
    while waiting:
        latest = 0.0
        for robot in range(robots):
            latest = max(latest, plan.ends[robot])
        best, best_at, best_robot, best_place = INF, -1, -1, -1
        for at in range(waiting):
            for robot in range(robots):
                added, place = cheapest_place(problem, plan, plan.removed[at], robot, latest, best)
                if place >= 0:
                    best, best_at, best_robot, best_place = added, at, robot, place
        if best_robot < 0:
            break
        tour = plan.tour[best_robot]
        for place in range(plan.count[best_robot], best_place, -1):
            tour[place] = tour[place - 1]
        tour[best_place] = plan.removed[best_at]
        plan.count[best_robot] += 1
        measure(problem, plan, best_robot)
        waiting -= 1
        plan.removed[best_at] = plan.removed[waiting]
    return waiting


def cheapest_place(
    problem: Problem, plan: Plan, target: int, robot: int, latest: float, best: float
) -> tuple[float, int]:
    """Where in a robot's tour a target adds least to the plan's cost, and how much; place -1 where not below `best`.

    No arrival is earlier than on the direct way or than that of the stop before: there the search gives up.
    """
    first, legs, pace = problem.first[robot], problem.legs[problem.kinds[robot]], problem.pace[robot]
    best_place = -1
    if first[target] >= best:
        return best, best_place
    tour, stops, end = plan.tour[robot], plan.count[robot], plan.ends[robot]
    now, before = 0.0, -1
    for place in range(stops + 1):
        if now >= best:
            break
        there = first[target] if before < 0 else now + legs[before][target] * pace
        if place < stops:
            after = tour[place]
            onward = first[after] if before < 0 else now + legs[before][after] * pace
            delay = there + legs[target][after] * pace - onward
            added = there + delay * (stops - place) + MAKESPAN_WEIGHT * max(0.0, end + delay - latest)
            now, before = onward, after
        else:
            added = there + MAKESPAN_WEIGHT * max(0.0, there - latest)
        if added < best:
            best, best_place = added, place
    return best, best_place


def take_out(problem: Problem, plan: Plan, number: int) -> int:
    """Take the target out that stands at `number`, counted through all tours."""
    robot = 0
    while number >= plan.count[robot]:
        number -= plan.count[robot]
        robot += 1
    tour = plan.tour[robot]
    target: int = tour[number]
    plan.count[robot] -= 1
    for place in range(number, plan.count[robot]):
        tour[place] = tour[place + 1]
    measure(problem, plan, robot)
    return target


def measure(problem: Problem, plan: Plan, robot: int) -> None:
    """Arrival times of one robot's tour."""
    first, legs, pace = problem.first[robot], problem.legs[problem.kinds[robot]], problem.pace[robot]
    tour = plan.tour[robot]
    total, now, before = 0.0, 0.0, -1
    for place in range(plan.count[robot]):
        target = tour[place]
        now = first[target] if before < 0 else now + legs[before][target] * pace
        total += now
        before = target
    plan.sums[robot] = total
    plan.ends[robot] = now


def cost_of(plan: Plan, robots: int) -> float:
    """What the search makes small."""
    total, latest = 0.0, 0.0
    for robot in range(robots):
        total += plan.sums[robot]
        latest = max(latest, plan.ends[robot])
    return total + MAKESPAN_WEIGHT * latest


def keep(plan: Plan, robots: int) -> None:
    """Remember the tours."""
    for robot in range(robots):
        plan.kept_count[robot] = plan.count[robot]
        for place in range(plan.count[robot]):
            plan.kept[robot][place] = plan.tour[robot][place]


def undo(problem: Problem, plan: Plan, robots: int) -> None:
    """Go back to the remembered tours."""
    for robot in range(robots):
        plan.count[robot] = plan.kept_count[robot]
        for place in range(plan.count[robot]):
            plan.tour[robot][place] = plan.kept[robot][place]
        measure(problem, plan, robot)
