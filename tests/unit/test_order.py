"""Frames in the order in which they were sent."""

from __future__ import annotations

from gatar_edge.bridge.order import Order

S = 1_000_000_000


def test_numbers_rise_beyond_the_one_byte_that_carries_them() -> None:
    order = Order()
    numbers = [order.number(n % 256, n * S // 400) for n in range(1000)]
    assert numbers == list(range(1000))


def test_a_frame_that_comes_late_or_twice_keeps_its_number() -> None:
    order = Order()
    assert [order.number(seq, 0) for seq in (250, 3, 252, 3)] == [250, 259, 252, 259]


def test_after_a_silence_every_frame_is_new() -> None:
    order = Order()
    order.number(200, 0)
    order.number(201, 0)
    assert order.number(150, 2 * S) > 201
