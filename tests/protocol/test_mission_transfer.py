"""The mission client against a scripted vehicle, message by message, on a fake clock."""

from __future__ import annotations

import random
from collections import deque

import pytest
from bridge_mission_server import ME, MS, VEHICLE, Server

from gatar_edge.bridge import wire
from gatar_edge.bridge.dialect import MissionResult
from gatar_edge.bridge.mission_items import MAX_ITEMS, Items, build, same_mission
from gatar_edge.bridge.mission_states import TRANSITIONS, Event, Result, Step
from gatar_edge.bridge.mission_transfer import MissionClient
from gatar_edge.bridge.profiles import PROFILES
from gatar_edge.bridge.wire import MissionAck, MissionCount, MissionItemAt, MissionRequest

S = 1_000_000_000
ROVER, PX4_ROVER = PROFILES[1], PROFILES[3]


def mission(n: int, profile: object = ROVER, shift: float = 0.0) -> Items:
    return build(profile, tuple((10 + i * 1e-3 + shift, 20.0) for i in range(n)), 5.0)  # type: ignore[arg-type]


class Talk:
    """A client whose peer is the test itself."""

    def __init__(self, profile: object = ROVER) -> None:
        self.client = MissionClient(profile, ME, VEHICLE, random.Random(1))  # type: ignore[arg-type]
        self.now = 100 * S

    def upload(self, items: Items) -> list[object]:
        self.client.upload(items, self.now)
        return self.sent()

    def sent(self) -> list[object]:
        return list(self.client.poll(self.now))

    def wait(self, seconds: float) -> list[object]:
        """What is sent while time passes in steps of 100 ms."""
        out: list[object] = []
        for _ in range(round(seconds * 10)):
            self.now += 100 * MS
            out += self.client.poll(self.now)
        return out

    def hear(self, message: object, source: wire.Address = VEHICLE) -> list[object]:
        self.client.receive(source, message, self.now)  # type: ignore[arg-type]
        return self.sent()

    def ask(self, *seqs: int) -> list[object]:
        return [m for seq in seqs for m in self.hear(MissionRequest(ME, seq))]

    def ack(self, result: MissionResult) -> list[object]:
        return self.hear(MissionAck(ME, result))

    def uploaded(self, items: Items) -> Talk:
        self.upload(items)
        self.ask(*range(len(items)))
        self.ack(MissionResult.ACCEPTED)
        assert self.client.result is Result.ACCEPTED
        self.wait(2)
        return self


def seqs(messages: list[object]) -> list[int]:
    return [m.seq for m in messages if isinstance(m, MissionItemAt)]


def counts(messages: list[object]) -> int:
    return sum(isinstance(m, MissionCount) for m in messages)


def test_an_upload_sends_the_count_and_then_only_what_is_requested() -> None:
    talk = Talk()
    items = mission(2)
    assert talk.upload(items) == [MissionCount(VEHICLE, 3)]
    assert talk.ask(0) == [MissionItemAt(VEHICLE, 0, items[0])]
    assert seqs(talk.wait(0.5)) == []
    assert seqs(talk.ask(1, 2)) == [1, 2]
    assert talk.client.result is None
    talk.ack(MissionResult.ACCEPTED)
    assert talk.client.result is Result.ACCEPTED


def test_an_item_is_sent_every_time_it_is_requested() -> None:
    talk = Talk()
    talk.upload(mission(2))
    assert seqs(talk.ask(0, 1, 1, 0, 1, 2)) == [0, 1, 1, 0, 1, 2]


def test_a_late_request_is_answered_after_the_upload_was_accepted() -> None:
    talk = Talk().uploaded(mission(2))
    assert seqs(talk.ask(2)) == [2]


def test_a_request_beyond_the_end_is_not_answered_and_does_not_keep_the_upload_alive() -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0)
    for _ in range(700):
        talk.now += 100 * MS
        assert seqs(talk.ask(3)) == []
        if talk.client.result is not None:
            break
    assert talk.client.result in (Result.TIMEOUT, Result.NO_ANSWER)


def test_the_count_is_sent_each_second_ten_times_and_then_given_up() -> None:
    talk = Talk()
    first = talk.upload(mission(2))
    later = talk.wait(30)
    assert counts(first + later) == len(first + later) == 10
    assert talk.client.result is Result.NO_ANSWER


def test_the_count_is_not_sent_again_once_a_request_came() -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0)
    assert talk.wait(7) == []


def test_silence_during_the_upload_starts_it_again() -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0)
    assert talk.wait(8) == []  # ArduPilot holds its upload open that long
    assert counts(talk.wait(1)) == 1


@pytest.mark.parametrize("noise", [MissionResult.INVALID_SEQUENCE, MissionResult.ERROR, MissionResult.DENIED])
def test_noise_during_the_upload_does_not_end_it(noise: MissionResult) -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0, 1)
    assert talk.ack(noise) == []
    assert talk.client.result is None
    talk.ask(2)
    talk.ack(MissionResult.ACCEPTED)
    assert talk.client.result is Result.ACCEPTED


def test_accepted_does_not_count_before_every_item_was_requested() -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0, 2)
    talk.ack(MissionResult.ACCEPTED)
    assert talk.client.result is None


def test_a_dropped_upload_is_started_again() -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0, 1)
    assert talk.ack(MissionResult.OPERATION_CANCELLED) == [MissionCount(VEHICLE, 3)]
    talk.ask(2)
    talk.ack(MissionResult.ACCEPTED)
    assert talk.client.result is None  # 0 and 1 went to the upload that was dropped
    talk.ask(0, 1, 2)
    talk.ack(MissionResult.ACCEPTED)
    assert talk.client.result is Result.ACCEPTED


@pytest.mark.parametrize(
    "refusal", [r for r in MissionResult if MissionResult.UNSUPPORTED_FRAME <= r <= MissionResult.INVALID_PARAM7]
)
def test_each_refusal_ends_the_upload_under_its_own_name(refusal: MissionResult) -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0)
    talk.ack(refusal)
    assert talk.client.result is Result[refusal.name]


def test_a_busy_vehicle_is_asked_again_after_a_pause_with_jitter() -> None:
    pauses = []
    for seed in range(5):
        talk = Talk()
        talk.client._jitter = random.Random(seed)
        talk.upload(mission(2))
        talk.ack(MissionResult.DENIED)
        start = talk.now
        while not counts(talk.wait(0.1)):
            pass
        pauses.append((talk.now - start) / S)
    assert all(2 <= p <= 4.1 for p in pauses)
    assert len(set(pauses)) > 1


def test_a_vehicle_that_stays_busy_is_given_up_as_denied() -> None:
    talk = Talk()
    talk.upload(mission(2))
    while talk.client.result is None:
        if counts(talk.wait(0.1)):
            talk.ack(MissionResult.DENIED)
        talk.ack(MissionResult.DENIED)
    assert talk.client.result is Result.DENIED


@pytest.mark.parametrize(
    ("source", "target", "mission_type"),
    [
        ((8, 1), ME, 0),  # another vehicle
        ((7, 190), ME, 0),  # another component of ours
        (VEHICLE, (255, 190), 0),  # for the ground station
        (VEHICLE, (7, 0), 0),
        (VEHICLE, ME, 1),  # the fence's items
    ],
)
def test_what_is_not_of_our_transfer_is_ignored(source: wire.Address, target: wire.Address, mission_type: int) -> None:
    talk = Talk()
    talk.upload(mission(1))
    assert talk.hear(MissionRequest(target, 0, mission_type), source) == []
    talk.ask(0, 1)
    talk.hear(MissionAck(target, MissionResult.ACCEPTED, mission_type), source)
    assert talk.client.result is None


def read_back(talk: Talk, items: Items) -> None:
    talk.hear(MissionCount(ME, len(items)))
    for seq, item in enumerate(items):
        talk.hear(MissionItemAt(ME, seq, item))


def test_a_missing_last_acknowledgement_is_settled_by_download_and_compare() -> None:
    talk = Talk()
    items = mission(2)
    talk.upload(items)
    talk.ask(0, 1, 2)
    assert talk.wait(2.1) == [wire.MissionRequestList(VEHICLE)]
    read_back(talk, items)
    assert talk.client.result is Result.ACCEPTED


def test_requests_are_still_answered_during_the_comparison() -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0, 1, 2)
    talk.wait(2.1)
    talk.hear(MissionCount(ME, 3))
    assert seqs(talk.ask(2)) == [2]
    talk.ack(MissionResult.ACCEPTED)
    assert talk.client.result is Result.ACCEPTED


@pytest.mark.parametrize("board", [mission(1), mission(3), mission(2, shift=1.0), ()])
def test_a_comparison_that_finds_something_else_starts_again(board: Items) -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0, 1, 2)
    talk.wait(2.1)
    out = talk.hear(MissionCount(ME, len(board)))
    for seq, item in enumerate(board):
        out += talk.hear(MissionItemAt(ME, seq, item))
    assert counts(out) == 1
    assert talk.client.result is None


def test_every_download_is_ended_with_an_acknowledgement() -> None:
    talk = Talk()
    talk.client.download(talk.now)
    talk.sent()
    talk.hear(MissionCount(ME, 1))
    out = talk.hear(MissionItemAt(ME, 0, mission(1)[1]))
    assert out == [MissionAck(VEHICLE, MissionResult.ACCEPTED)]
    assert talk.client.result is Result.DOWNLOADED
    assert talk.client.downloaded == (mission(1)[1],)


def test_a_repeated_count_restarts_the_download_from_its_start() -> None:
    talk = Talk(PX4_ROVER)
    talk.client.download(talk.now)
    talk.hear(MissionCount(ME, 2))
    talk.hear(MissionItemAt(ME, 0, mission(2)[1]))
    assert talk.hear(MissionCount(ME, 2)) == [MissionRequest(VEHICLE, 0)]


def test_an_empty_vehicle_downloads_nothing() -> None:
    talk = Talk()
    talk.client.download(talk.now)
    talk.hear(MissionCount(ME, 0))
    assert (talk.client.result, talk.client.downloaded) == (Result.DOWNLOADED, ())


def test_a_mission_that_is_on_board_is_not_sent_again() -> None:
    talk = Talk().uploaded(mission(2))
    assert talk.upload(mission(2)) == []
    assert talk.client.result is Result.ALREADY_ON_BOARD


@pytest.mark.parametrize(
    ("total", "state", "again"), [(2, 3, 0), (2, 1, 0), (0, 0, 0), (65535, 0, 0), (3, 3, 1), (0, 1, 1)]
)
def test_a_mission_is_sent_again_where_the_vehicle_counts_another(total: int, state: int, again: int) -> None:
    talk = Talk().uploaded(mission(2))
    talk.hear(wire.MissionCurrent(1, total, state))
    assert counts(talk.upload(mission(2))) == again


def test_what_the_vehicle_counted_before_its_new_mission_and_is_heard_late_is_not_believed() -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0, 1, 2)
    talk.ack(MissionResult.ACCEPTED)
    talk.hear(wire.MissionCurrent(1, 5, 3))
    assert talk.upload(mission(2)) == []


def test_a_mission_is_sent_again_after_somebody_else_changed_it() -> None:
    talk = Talk().uploaded(mission(2))
    talk.client.forget()
    assert counts(talk.upload(mission(2))) == 1


def test_an_acknowledgement_that_may_be_of_the_upload_before_is_verified_by_download() -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0, 1, 2)
    talk.ack(MissionResult.ACCEPTED)
    other = mission(2, shift=1.0)
    talk.upload(other)  # at once: a copy of the last ACK may still be under way
    talk.ask(0, 1, 2)
    assert talk.ack(MissionResult.ACCEPTED) == [wire.MissionRequestList(VEHICLE)]
    assert talk.client.result is None
    read_back(talk, other)
    assert talk.client.result is Result.ACCEPTED


def test_a_new_upload_cancels_the_one_under_way() -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0)
    out = talk.upload(mission(3))
    assert out == [MissionAck(VEHICLE, MissionResult.OPERATION_CANCELLED), MissionCount(VEHICLE, 4)]


def test_an_upload_that_a_delayed_count_opened_again_is_followed_to_its_end() -> None:
    talk = Talk().uploaded(mission(2))
    talk.ask(0)  # the vehicle has truncated its mission
    assert talk.client.active
    assert talk.client.on_board is None
    talk.ask(1, 2)
    talk.ack(MissionResult.ACCEPTED)
    read_back(talk, mission(2))
    assert talk.client.result is Result.ACCEPTED


@pytest.mark.parametrize(
    "items",
    [
        (),
        (*mission(1), *mission(MAX_ITEMS)),
        (wire.MissionItem(6, 16, (0, 0, 0, 0), 10**10, 0, 0.0),),
        (wire.MissionItem(6, 16, (0, 0, 0, 0), 0, 0, float("nan")),),
        (wire.MissionItem(6, 16, (float("inf"), 0, 0, 0), 0, 0, 0.0),),
    ],
)
def test_what_cannot_be_sent_is_refused_before_a_byte_leaves(items: Items) -> None:
    talk = Talk()
    assert talk.upload(items) == []
    assert talk.client.result is Result.NOT_SENDABLE


@pytest.mark.parametrize(
    ("answer", "result"),
    [
        (MissionResult.ACCEPTED, Result.CLEARED),
        (MissionResult.ERROR, Result.PEER_ERROR),  # ArduPilot, armed and running it
        (MissionResult.DENIED, Result.DENIED),
        (MissionResult.UNSUPPORTED, Result.UNSUPPORTED),
    ],
)
def test_clearing_ends_with_the_vehicles_word(answer: MissionResult, result: Result) -> None:
    talk = Talk()
    talk.client.clear(talk.now)
    assert talk.sent() == [wire.MissionClearAll(VEHICLE)]
    talk.ack(answer)
    assert talk.client.result is result


def test_after_giving_way_nothing_is_answered() -> None:
    talk = Talk()
    talk.upload(mission(2))
    talk.ask(0)
    talk.client.abandon()
    assert talk.ask(1) == []
    assert talk.client.result is Result.CANCELLED


def test_every_step_can_be_reached_and_left() -> None:
    reached = {to for row in TRANSITIONS.values() for to in row.values()}
    assert reached == set(Step) == set(TRANSITIONS)
    assert {event for row in TRANSITIONS.values() for event in row} == set(Event)


@pytest.mark.parametrize("ardupilot", [True, False])
def test_two_clients_of_one_seed_send_the_same(ardupilot: bool) -> None:
    def run() -> deque[object]:
        log: deque[object] = deque()
        server, talk = Server(ardupilot), Talk(ROVER if ardupilot else PX4_ROVER)
        talk.client.upload(mission(5, talk.client.profile), talk.now)
        for _ in range(50):
            talk.now += 20 * MS
            for message in talk.sent():
                log.append(message)
                server.receive(message, talk.now)
            server.tick(talk.now)
            for answer in server.out:
                talk.client.receive(VEHICLE, answer, talk.now)  # type: ignore[arg-type]
            server.out = []
        assert talk.client.result is Result.ACCEPTED
        assert same_mission(mission(5, talk.client.profile), tuple(server.board), talk.client.profile)
        return log

    assert run() == run()
