"""Invariant: any bytes are one message, which encodes to the same bytes again, or a MessageError; nothing else."""

from __future__ import annotations

import hashlib

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from gatar_edge.errors import MessageError
from gatar_edge.keys import DEMO_KEY
from gatar_edge.message import MESSAGE_BYTES, NeighborMessage, decode, encode, with_hops
from gatar_edge.neighbors import HearOutcome, NeighborTable
from gatar_edge.types import RobotKind, TaskKind

REPEATABLE = settings(derandomize=True, deadline=None, database=None, max_examples=300)

coordinates = st.integers(-0x8000, 0x7FFF)
cells = st.tuples(coordinates, coordinates)
windows = st.binary(min_size=225, max_size=225).map(
    lambda data: (np.frombuffer(data, np.uint8) % 5).astype(np.uint8).reshape(15, 15)
)
messages = st.builds(
    NeighborMessage,
    robot_id=st.integers(0, 0xFFFF),
    kind=st.sampled_from(RobotKind),
    seq=st.integers(0, 0xFFFF_FFFF),
    t_ms=st.integers(0, (1 << 48) - 1),
    cell=cells,
    speed_cells_s=st.integers(0, 0xFF).map(lambda sixteenths: sixteenths / 16),
    task=st.sampled_from(TaskKind),
    task_cell=cells,
    cost=st.integers(0, 0xFFFF).map(lambda sixteenths: sixteenths / 16),
    window_origin=cells,
    window=windows,
    config_digest=st.integers(0, 0xFFFF_FFFF),
    hops=st.integers(0, 0xFF),
)
# what a holder of the key could send: rightly signed, otherwise anything
signed_bodies = st.binary(min_size=118, max_size=118).map(
    lambda body: b"\1" + body + hashlib.blake2b(b"\1" + body, digest_size=8, key=DEMO_KEY, person=b"gatar-v1").digest()
)


def decode_or_none(data: bytes) -> NeighborMessage | None:
    """The message, or None for the one error that is allowed; its sentence is one line."""
    try:
        return decode(data, DEMO_KEY)
    except MessageError as error:
        sentence = str(error)
    assert len(sentence.splitlines()) == 1
    return None


@REPEATABLE
@given(messages)
def test_each_message_reads_back_as_it_was(message: NeighborMessage) -> None:
    data = encode(message, DEMO_KEY)
    assert len(data) == MESSAGE_BYTES
    assert decode(data, DEMO_KEY) == message


@REPEATABLE
@given(st.binary(max_size=300))
def test_any_bytes_are_refused_with_one_typed_error(data: bytes) -> None:
    assert decode_or_none(data) is None


@REPEATABLE
@given(messages, st.data())
def test_a_message_changed_on_the_way_is_refused(message: NeighborMessage, data: st.DataObject) -> None:
    original = encode(message, DEMO_KEY)
    damaged = bytearray(original)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, MESSAGE_BYTES - 1))] = data.draw(st.integers(0, 255))
    cut = bytes(damaged[: data.draw(st.integers(0, MESSAGE_BYTES))])
    for received in (bytes(damaged), cut):
        assert (decode_or_none(received) is None) == (received != original)


@REPEATABLE
@given(signed_bodies)
def test_whatever_a_holder_of_the_key_signs_is_one_canonical_message_or_refused(data: bytes) -> None:
    message = decode_or_none(data)
    assert message is None or encode(message, DEMO_KEY) == data


@REPEATABLE
@given(messages, st.binary(min_size=225, max_size=225))
def test_a_window_is_accepted_exactly_when_all_its_codes_are_known(message: NeighborMessage, raw: bytes) -> None:
    # few codes above 4, so that both outcomes occur
    codes = [byte % 5 if byte > 3 else byte + 4 for byte in raw]
    bits = sum((code >> plane & 1) << plane * 225 + at for plane in range(3) for at, code in enumerate(codes))
    body = encode(message, DEMO_KEY)[:34] + bits.to_bytes(85, "little")
    signature = hashlib.blake2b(body, digest_size=8, key=DEMO_KEY, person=b"gatar-v1").digest()
    read = decode_or_none(body + signature)
    assert (read is not None) == (max(codes) <= 4)
    assert read is None or read.window.ravel().tolist() == codes


@REPEATABLE
@given(messages, st.integers(0, 255))
def test_a_relay_of_a_relay_is_the_message_with_other_hops(message: NeighborMessage, hops: int) -> None:
    relayed = with_hops(with_hops(encode(message, DEMO_KEY), 3, DEMO_KEY), hops, DEMO_KEY)
    assert decode(relayed, DEMO_KEY) == replace(message, hops=hops)


@REPEATABLE
@given(st.lists(st.one_of(st.binary(max_size=200), signed_bodies, messages.map(lambda m: encode(m, DEMO_KEY)))))
def test_hearing_takes_anything_and_counts_it(inbox: list[bytes]) -> None:
    hearing = NeighborTable(1, DEMO_KEY, 0, hop_limit=300, max_age_ns=3, r_comm=6.0)
    outcomes = [hearing.hear(data, now_ns, (7, 7)).outcome for now_ns, data in enumerate(inbox)]
    assert hearing.counters == {outcome: outcomes.count(outcome) for outcome in HearOutcome}


@REPEATABLE
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 5), st.integers(0, 3)), max_size=40))
def test_each_message_is_news_once_and_is_relayed_over_ever_fewer_hops(arrivals: list[tuple[int, int, int]]) -> None:
    window = np.zeros((15, 15), np.uint8)
    plain = NeighborMessage(0, RobotKind.UAV, 0, 0, (0, 0), 0.0, TaskKind.HOLD, (0, 0), 0.0, (0, 0), window, 0)
    hearing = NeighborTable(9, DEMO_KEY, 0, hop_limit=4, max_age_ns=1, r_comm=6.0)
    newest: dict[int, int] = {}
    relayed: dict[tuple[int, int], int] = {}
    for author, seq, hops in arrivals:
        heard = hearing.hear(encode(replace(plain, robot_id=author, seq=seq, hops=hops), DEMO_KEY), 0)
        assert (heard.outcome is HearOutcome.ACCEPTED) == (seq > newest.get(author, -1))
        newest[author] = max(seq, newest.get(author, -1))
        if heard.relay is not None:
            assert hops < relayed.get((author, seq), 4)
            relayed[author, seq] = hops
