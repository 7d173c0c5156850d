"""Who passes a message on: few, but always somebody for each robot that may lack it."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from gatar_edge.relaying import IN_RANGE_COPIES, OUT_OF_RANGE_COPIES, Place, passes_on

R_COMM = 6.0

cells = st.tuples(st.integers(0, 14), st.integers(0, 14))
teams = st.lists(cells, min_size=3, max_size=12)


def relayers(team: list[Place], author: Place, seq: int) -> list[Place]:
    """Those of the team that pass on what they heard from the author, each knowing where everybody is."""
    return [
        robot
        for robot in team
        if robot is not author
        and math.dist(robot.cell, author.cell) <= R_COMM
        and passes_on(robot, author, seq, [other for other in team if other is not robot], R_COMM)
    ]


def cluster(count: int) -> list[Place]:
    return [Place(number + 1, (5 + number % 4, 5 + number // 4)) for number in range(count)]


def test_of_a_team_that_all_hears_each_other_two_pass_a_message_on() -> None:
    team = cluster(12)

    assert {len(relayers(team, author, seq)) for author in team for seq in range(50)} <= {
        IN_RANGE_COPIES,
        IN_RANGE_COPIES + 1,  # a robot needs not be told by itself
    }


def test_the_turn_goes_round() -> None:
    team = cluster(12)
    turns = [robot.robot_id for seq in range(200) for robot in relayers(team, team[0], seq)]

    assert set(turns) == {robot.robot_id for robot in team[1:]}
    assert max(turns.count(robot_id) for robot_id in set(turns)) < 4 * min(
        turns.count(robot_id) for robot_id in set(turns)
    )


def test_the_only_way_to_a_robot_is_always_used() -> None:
    author, between, behind = Place(1, (0, 0)), Place(2, (5, 0)), Place(3, (10, 0))

    assert all(passes_on(between, author, seq, [author, behind], R_COMM) for seq in range(50))


def test_nobody_passes_on_what_nobody_lacks() -> None:
    author, own = Place(1, (0, 0)), Place(2, (5, 0))

    assert not passes_on(own, author, 7, [author], R_COMM)
    assert not passes_on(own, author, 7, [author, Place(3, (14, 14))], R_COMM)


def test_a_robot_that_may_have_moved_does_not_count_as_one_that_surely_helps() -> None:
    author, own, behind = Place(1, (0, 0)), Place(2, (5, 0)), Place(3, (10, 0))
    standing = [Place(robot_id, (5, 1)) for robot_id in range(4, 12)]
    moving = [place._replace(moved_cells=3.0) for place in standing]

    assert not all(passes_on(own, author, seq, [author, behind, *standing], R_COMM) for seq in range(50))
    assert all(passes_on(own, author, seq, [author, behind, *moving], R_COMM) for seq in range(50))


@given(team=teams, seq=st.integers(0, 2**32 - 1))
def test_each_robot_is_told_as_often_as_asked_or_by_all_who_can(team: list[tuple[int, int]], seq: int) -> None:
    places = [Place(number + 1, cell) for number, cell in enumerate(team)]
    for author in places:
        sent = relayers(places, author, seq)
        for robot in places:
            if robot is author:
                continue
            able = [
                other
                for other in places
                if other not in (author, robot)
                and math.dist(other.cell, author.cell) <= R_COMM
                and math.dist(other.cell, robot.cell) <= R_COMM
            ]
            copies = IN_RANGE_COPIES if math.dist(robot.cell, author.cell) <= R_COMM else OUT_OF_RANGE_COPIES
            assert len([one for one in able if one in sent]) >= min(copies, len(able))
