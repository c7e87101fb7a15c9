"""Radio between a client and a drone: latency, silences, loss and cut links."""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

SILENCE = 0.3  # s; duration of a random silence
LINK_LOST = 2.0  # s of silence after which the link counts as lost, as for a real client's radio
HELD = 100  # packets each way that are held until the end of a silence; further ones are lost
SPACING = 0.002  # s between two packets of one direction: a radio carries about 500 a second


class RadioConditions(NamedTuple):
    """Properties of a radio link.

    Attributes:
        latency: Least transmission time of a packet, s.
        tail: Mean of an exponentially distributed additional time, s.
        silences: Mean number of silences of 0.3 s per minute.
        loss: Probability that a packet is lost, once a client has connected.
    """

    latency: float = 0.005
    tail: float = 0.0
    silences: float = 0.0
    loss: float = 0.0


class PacketQueue:
    """Packets in transit in one direction. They stay in order, since the radio waits for each acknowledgement."""

    def __init__(self) -> None:
        self._in_transit: deque[tuple[float, bytes]] = deque()
        self._last = -SPACING

    @property
    def next(self) -> float | None:
        """Instant at which the next packet is received, s; None if there is none."""
        return self._in_transit[0][0] if self._in_transit else None

    def send(self, due: float, wire: bytes) -> None:
        """Let a packet be received at `due`, s, or right after the previous one if that is later."""
        self._last = max(self._last + SPACING, due)
        self._in_transit.append((self._last, wire))

    def pop_due(self, now: float) -> Iterator[tuple[float, bytes]]:
        """Remove the packets received by `now`, s; yield the instant and the bytes of each."""
        while self._in_transit and self._in_transit[0][0] <= now:
            yield self._in_transit.popleft()

    def clear(self) -> None:
        """Lose all packets in transit."""
        self._in_transit.clear()
        self._last = -SPACING

    def waiting(self, now: float) -> int:
        """Return the number of packets not received by `now`, s."""
        return sum(due > now for due, _ in self._in_transit)


class Radio:
    """Radio link with latency, silences and loss, which can be cut.

    In a silence no packet gets through in either direction; up to 100 packets each way are received after it. After a
    silence of 2 s, or with the link cut for as long, the link is lost, together with all packets in transit.

    Args:
        conditions: Properties of the link.
        rng: Source of times and losses.

    Attributes:
        up: Packets to the drone.
        down: Packets from the drone.
        loss: Probability that a packet is lost.
        connected: A client has connected; only then packets are lost.
    """

    def __init__(self, conditions: RadioConditions, rng: np.random.Generator) -> None:
        self.up, self.down = PacketQueue(), PacketQueue()
        self.loss = conditions.loss
        self.connected = False
        self._conditions = conditions
        self._rng = rng
        self._silent_from = self._silent_until = 0.0
        self._next_silence = self._draw_silence(0.0)

    def send_up(self, now: float, wire: bytes) -> None:
        """Send a packet from the client, at `now`, s."""
        self._enqueue(self.up, now, wire)

    def send_down(self, now: float, wire: bytes) -> None:
        """Send a packet from the drone, at `now`, s."""
        self._enqueue(self.down, now, wire)

    def silence(self, now: float, duration: float) -> None:
        """Begin a silence at `now`, for a `duration`, s."""
        if now >= self._silent_until:
            self._silent_from = now
        self._silent_until = max(self._silent_until, now + duration)

    def restore(self, now: float) -> None:
        """End a silence at `now`, s. The packets held by it are lost."""
        self._silent_until = now
        self.clear()

    def clear(self) -> None:
        """Lose all packets in transit, in both directions."""
        self.up.clear()
        self.down.clear()

    def lost(self, now: float) -> bool:
        """Return whether the link counts as lost at `now`, s."""
        return self._silent_until > now >= self._silent_from + LINK_LOST

    def _enqueue(self, queue: PacketQueue, now: float, wire: bytes) -> None:
        while now >= self._next_silence:
            self.silence(self._next_silence, SILENCE)
            self._next_silence = self._draw_silence(self._next_silence)
        delay = self._conditions.latency + (
            self._rng.exponential(self._conditions.tail) if self._conditions.tail else 0.0
        )
        if self.connected and self.loss and self._rng.random() < self.loss:
            return
        if self._silent_from <= now < self._silent_until:
            if queue.waiting(now) < HELD:
                queue.send(self._silent_until + delay, wire)
            return
        queue.send(now + delay, wire)

    def _draw_silence(self, after: float) -> float:
        if not self._conditions.silences:
            return float("inf")
        return after + self._rng.exponential(60.0 / self._conditions.silences)
