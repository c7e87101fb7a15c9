"""A link that carries so many bytes a second and not more."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.faults.limits import LONGEST, at_least, positive
from dcf_zenoh.messaging.delivery import Delivery

BEFORE_ALL_TIME = -(2**63)  # ns


class Bandwidth(Fault):
    """Token bucket with a finite queue.

    Tokens, one for each byte, flow into a bucket at a constant rate until it is full, as it is at the beginning. A
    message leaves when the bucket holds as many as it has bytes, and takes them along; until then it waits, behind
    those that came before. A message that finds no room in the queue is lost, and so is one that is larger than the
    bucket. Sizes are those of the encoded messages, without what transport adds.

    A message is due as much later as it waited. It leaves at a whole ns, the first at or after the exact instant; the
    exact instants are carried on, so rounding never adds up. A rule for another time has a bucket of its own.

    Args:
        rate: In bytes/s.
        burst: Size of the bucket, in bytes: as much can leave at once. The default is an Ethernet frame.
        queue: How much can wait, in bytes. The default is ten of those.

    Raises:
        ValueError: `rate` or `burst` is not positive, or `queue` is negative.

    Source: the bucket and its queue are those of Linux tc-tbf(8). The bucket is not filled step by step; its state is
    the instant at which it was or will be empty, as in the virtual scheduling algorithm of ITU-T I.371.
    """

    STAGE = Stage.QUEUE

    def __init__(self, *, rate: float, burst: int = 1500, queue: int = 15_000) -> None:
        numerator, denominator = float(positive("rate", rate, "bytes/s")).as_integer_ratio()
        self._unit = numerator  # of exact instants, so many to the ns
        self._byte = denominator * 1_000_000_000  # in which a byte's token flows in, in those units
        self._burst = int(positive("burst", burst, "bytes"))
        self._limit = int(at_least("queue", queue, 0, "bytes"))
        at_least("rate", rate, (self._limit + self._burst) / LONGEST, "bytes/s")
        self._empty = BEFORE_ALL_TIME * self._unit  # when the bucket was or will be, exactly
        self._waiting: deque[tuple[int, int]] = deque()  # departure in ns, and size
        self._waiting_bytes = 0

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:  # noqa: ARG002
        """Let it wait, or lose it."""
        now, size = delivery.entered, delivery.size
        while self._waiting and self._waiting[0][0] <= now:
            self._waiting_bytes -= self._waiting.popleft()[1]
        if size > self._burst:
            return ()
        full = now * self._unit - self._burst * self._byte  # when a bucket that is full now would have been empty
        empty = max(self._empty, full) + size * self._byte
        departure = -(-empty // self._unit)
        if departure > now:
            if self._waiting_bytes + size > self._limit:
                return ()
            self._waiting.append((departure, size))
            self._waiting_bytes += size
        self._empty = empty
        return (delivery._replace(due=delivery.due + max(0, departure - now)),)
