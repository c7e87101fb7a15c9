"""Bandwidth: a link carries a limited number of bytes per second."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.faults.limits import LONGEST, at_least, positive
from dcf_zenoh.messaging.delivery import Delivery

BEFORE_ALL_TIME = -(2**63)  # ns


class Bandwidth(Fault):
    """Token bucket with a finite queue.

    Tokens flow into a bucket at a constant rate, one per byte, until it is full; it is full at the beginning. A message
    leaves when the bucket holds one token per byte of it, and removes these tokens. Until then it waits behind earlier
    messages. A message is lost if it finds no room in the queue, or is larger than the bucket. Sizes are those of the
    encoded messages, without the overhead of the transport.

    A message is due later by the time that it waited. It leaves at a whole ns, the first at or after the exact instant.
    The exact instants are kept, so rounding errors do not accumulate. A rule for another time has its own bucket.

    Args:
        rate: Tokens per second, in bytes/s.
        burst: Size of the bucket, in bytes: the most that can leave at once. The default is an Ethernet frame.
        queue: Size of the queue, in bytes. The default is ten Ethernet frames.

    Raises:
        ValueError: `rate` or `burst` is not positive, or `queue` is negative.

    Source: the bucket and its queue are those of Linux tc-tbf(8). The bucket is not filled step by step; its state is
    the instant at which it was or will be empty, as in the virtual scheduling algorithm of ITU-T I.371.
    """

    STAGE = Stage.QUEUE

    def __init__(self, *, rate: float, burst: int = 1500, queue: int = 15_000) -> None:
        numerator, denominator = float(positive("rate", rate, "bytes/s")).as_integer_ratio()
        self._unit = numerator  # exact instants are counted in units, this many to the ns
        self._byte = denominator * 1_000_000_000  # time in which the token of one byte flows in, in units
        self._burst = int(positive("burst", burst, "bytes"))
        self._limit = int(at_least("queue", queue, 0, "bytes"))
        at_least("rate", rate, (self._limit + self._burst) / LONGEST, "bytes/s")
        self._empty = BEFORE_ALL_TIME * self._unit  # exact instant at which the bucket was or will be empty
        self._waiting: deque[tuple[int, int]] = deque()  # departure in ns, size in bytes
        self._waiting_bytes = 0

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:  # noqa: ARG002
        """Delay the message by its time in the queue, or lose it."""
        now, size = delivery.entered, delivery.size
        while self._waiting and self._waiting[0][0] <= now:
            self._waiting_bytes -= self._waiting.popleft()[1]
        if size > self._burst:
            return ()
        full = now * self._unit - self._burst * self._byte  # instant at which a bucket that is full now was empty
        empty = max(self._empty, full) + size * self._byte
        departure = -(-empty // self._unit)
        if departure > now:
            if self._waiting_bytes + size > self._limit:
                return ()
            self._waiting.append((departure, size))
            self._waiting_bytes += size
        self._empty = empty
        return (delivery._replace(due=delivery.due + max(0, departure - now)),)
