from collections.abc import Iterator
from fractions import Fraction
from math import ceil
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcf_zenoh.faults.bandwidth import Bandwidth
from dcf_zenoh.messaging.delivery import Delivery
from tests.support.deliveries import MANY, MS, S, alone, delivery, padded

traffic = st.lists(st.tuples(st.sampled_from([0, 0, 1, 1000, 5 * MS, 40 * MS]), st.integers(0, 400)), max_size=60)
rates = st.one_of(st.integers(100, 10**8).map(float), st.floats(100, 1e8))
buckets = st.fixed_dictionaries({"rate": rates, "burst": st.integers(50, 1000), "queue": st.integers(0, 2000)})


def stream(pairs: list[tuple[int, int]]) -> Iterator[Delivery]:
    """Messages with so many bytes of payload, each so many ns after the one before."""
    at = 0
    for gap, padding in pairs:
        at += gap
        yield padded(padding, at)


def reference(offered: list[Delivery], rate: float, burst: int, queue: int) -> list[int | None]:
    """When messages leave, or None: the bucket filled step by step, in rational numbers."""
    tokens, at = Fraction(burst), Fraction(0)
    out: list[int | None] = []
    waiting: list[tuple[Fraction, int]] = []
    for each in offered:
        now, size = Fraction(each.entered), each.size
        waiting = [(leaves, length) for leaves, length in waiting if leaves > now]
        begins = max(now, at)  # it is first in the queue
        level = min(Fraction(burst), tokens + (begins - at) * Fraction(rate) / S)
        leaves = begins + max(Fraction(0), (size - level) * S / Fraction(rate))
        if size > burst or (leaves > now and sum(length for _, length in waiting) + size > queue):
            out.append(None)
            continue
        tokens = level + (leaves - begins) * Fraction(rate) / S - size
        at = leaves
        waiting.append((leaves, size))
        out.append(ceil(leaves))
    return out


@given(traffic, buckets)
def test_departures_are_those_of_a_bucket_filled_step_by_step(
    pairs: list[tuple[int, int]], bucket: dict[str, Any]
) -> None:
    fault = Bandwidth(**bucket)
    offered = list(stream(pairs))
    came = [alone(fault, each) for each in offered]
    expected = reference(offered, **bucket)
    assert [each[0].due if each else None for each in came] == expected


@given(traffic, buckets)
def test_no_window_carries_more_than_the_bucket_and_what_flows_in(
    pairs: list[tuple[int, int]], bucket: dict[str, Any]
) -> None:
    fault = Bandwidth(**bucket)
    left = [(each.due, each.size) for offered in stream(pairs) for each in alone(fault, offered)]
    for begin in range(len(left)):
        carried = 0
        for end in range(begin, len(left)):
            carried += left[end][1]
            window = left[end][0] - left[begin][0] + 1  # departures are rounded up to whole ns
            assert carried <= bucket["burst"] + Fraction(bucket["rate"]) * window / S


@given(traffic, buckets)
def test_queue_never_exceeds_its_limit(pairs: list[tuple[int, int]], bucket: dict[str, Any]) -> None:
    fault = Bandwidth(**bucket)
    left: list[tuple[int, int]] = []
    for offered in stream(pairs):
        left += [(each.due, each.size) for each in alone(fault, offered)]
        assert sum(size for due, size in left if due > offered.entered) <= bucket["queue"]


@given(traffic, buckets)
def test_messages_leave_in_the_order_in_which_they_entered(
    pairs: list[tuple[int, int]], bucket: dict[str, Any]
) -> None:
    fault = Bandwidth(**bucket)
    came = [each for offered in stream(pairs) for each in alone(fault, offered)]
    assert all(each.due >= each.entered for each in came)
    assert [each.due for each in came] == sorted(each.due for each in came)


@pytest.mark.parametrize("rate", [30_000.0, 1e9 / 7])
def test_departures_do_not_drift(rate: float) -> None:
    given = delivery()
    size = given.size
    fault = Bandwidth(rate=rate, burst=size, queue=size * (MANY + 1))
    rng = np.random.default_rng(0)
    for number in range(MANY):
        (after,) = fault.apply(given, rng)
        assert after.due == ceil(number * size * S / Fraction(rate))


def test_throughput_is_the_rate() -> None:
    rate, burst, queue = 20_000.0, 1500, 3000
    fault = Bandwidth(rate=rate, burst=burst, queue=queue)
    given, rng = delivery(), np.random.default_rng(0)
    interval = round(given.size / (2 * rate) * S)  # twice as much as the link carries
    carried, last = 0, 0
    for number in range(MANY):
        for each in fault.apply(Delivery(given.message, number * interval, number * interval), rng):
            carried, last = carried + given.size, each.due
    assert abs(carried - burst - rate * last / S) <= given.size
    assert abs(last - MANY * interval) <= (queue + given.size) / rate * S


def test_a_message_that_the_bucket_holds_leaves_at_once() -> None:
    given = delivery(entered=5)._replace(due=9)
    assert alone(Bandwidth(rate=1.0, burst=given.size), given) == [given]


def test_waiting_comes_on_top_of_what_delays_the_message_already() -> None:
    given = delivery(entered=5)._replace(due=9)
    fault = Bandwidth(rate=1000.0, burst=given.size)
    alone(fault, given)
    assert alone(fault, given) == [given._replace(due=9 + given.size * MS)]


def test_a_message_larger_than_the_bucket_is_lost_and_takes_nothing() -> None:
    small, large = delivery(payload={"x": 1}), delivery(payload={"xx": 1})
    assert large.size == small.size + 1
    fault = Bandwidth(rate=1.0, burst=small.size, queue=10_000)
    assert alone(fault, large) == []
    assert alone(fault, small) == [small]


def test_without_a_queue_nothing_waits() -> None:
    size = padded(0).size
    fault = Bandwidth(rate=float(size), burst=size, queue=0)  # one message a second
    offered = [padded(0)._replace(entered=at, due=at) for at in (0, 0, S - 1, S, S)]
    came = [bool(alone(fault, each)) for each in offered]
    assert came == [True, False, False, True, False]


def test_a_message_makes_room_in_the_queue_at_the_instant_at_which_it_leaves() -> None:
    size = padded(0).size
    fault = Bandwidth(rate=float(size), burst=size, queue=size)
    offered = [padded(0)._replace(entered=at, due=at) for at in (0, 0, 0, S - 1, S)]
    assert [[after.due for after in alone(fault, each)] for each in offered] == [[0], [S], [], [], [2 * S]]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"rate": 0.0}, "rate must be positive, in bytes/s, not 0.0"),
        ({"rate": 100.0, "burst": 0}, "burst must be positive, in bytes, not 0"),
        ({"rate": 100.0, "queue": -1}, "queue must be at least 0, in bytes, not -1"),
    ],
)
def test_a_bucket_that_cannot_be_is_refused(options: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=f"^{text}$"):
        Bandwidth(**options)
