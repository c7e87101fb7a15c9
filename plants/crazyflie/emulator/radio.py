"""The radio between a client and a drone, as users meet it."""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

SILENCE = 0.3  # s; how long a silence lasts that comes by itself
LINK_LOST = 2.0  # s of silence after which the link counts as lost, as the client's own radio finds
HELD = 100  # packets each way that wait for the end of a silence; more are lost


class Air(NamedTuple):
    """How the radio behaves.

    Attributes:
        latency: Shortest time of a packet under way, s.
        tail: Mean of an exponentially distributed time on top, s.
        silences: Mean number of silences of 0.3 s per minute.
        loss: Probability that a packet is lost, once a client has connected.
    """

    latency: float = 0.005
    tail: float = 0.0
    silences: float = 0.0
    loss: float = 0.0


class Way:
    """One direction. Packets stay in order: the radio sends the next when the last has been acknowledged."""

    def __init__(self) -> None:
        self._under_way: deque[tuple[float, bytes]] = deque()
        self._last = 0.0

    @property
    def next(self) -> float | None:
        """When the next packet arrives, s; None if there is none."""
        return self._under_way[0][0] if self._under_way else None

    def send(self, due: float, wire: bytes) -> None:
        """Let a packet arrive at `due`, s, or with the one before, if that is later."""
        self._last = max(self._last, due)
        self._under_way.append((self._last, wire))

    def arrive(self, now: float) -> Iterator[tuple[float, bytes]]:
        """The packets that have arrived by `now`, s, and when."""
        while self._under_way and self._under_way[0][0] <= now:
            yield self._under_way.popleft()

    def forget(self) -> None:
        """Lose what is under way."""
        self._under_way.clear()
        self._last = 0.0

    def waiting(self, now: float) -> int:
        """How many packets have not arrived by `now`, s."""
        return sum(due > now for due, _ in self._under_way)


class Radio:
    """Latency, silences, loss, and a link that can be cut.

    In a silence nothing gets through, either way; what was sent arrives after it, as far as there is room for it.
    After a silence of 2 s, or with the link cut for as long, the link is lost, and what was under way with it.

    Args:
        air: How it behaves.
        rng: Draws its times and losses.

    Attributes:
        up: To the drone.
        down: From the drone.
        loss: Probability that a packet is lost.
        connected: A client has connected, so that packets may be lost.
    """

    def __init__(self, air: Air, rng: np.random.Generator) -> None:
        self.up, self.down = Way(), Way()
        self.loss = air.loss
        self.connected = False
        self._air = air
        self._rng = rng
        self._silent_from = self._silent_until = 0.0
        self._next_silence = self._draw_silence(0.0)

    def send_up(self, now: float, wire: bytes) -> None:
        """A client sends, at `now`, s."""
        self._send(self.up, now, wire)

    def send_down(self, now: float, wire: bytes) -> None:
        """The drone sends, at `now`, s."""
        self._send(self.down, now, wire)

    def silence(self, now: float, duration: float) -> None:
        """Let nothing through from `now` on, for `duration`, s."""
        if now >= self._silent_until:
            self._silent_from = now
        self._silent_until = max(self._silent_until, now + duration)

    def restore(self, now: float) -> None:
        """End a silence. What it held is lost."""
        self._silent_until = now
        self.forget()

    def forget(self) -> None:
        """Lose what is under way, both ways."""
        self.up.forget()
        self.down.forget()

    def lost(self, now: float) -> bool:
        """Whether the link counts as lost at `now`, s."""
        return self._silent_until > now >= self._silent_from + LINK_LOST

    def _send(self, way: Way, now: float, wire: bytes) -> None:
        while now >= self._next_silence:
            self.silence(self._next_silence, SILENCE)
            self._next_silence = self._draw_silence(self._next_silence)
        delay = self._air.latency + (self._rng.exponential(self._air.tail) if self._air.tail else 0.0)
        if self.connected and self.loss and self._rng.random() < self.loss:
            return
        if self._silent_from <= now < self._silent_until:
            if way.waiting(now) < HELD:
                way.send(self._silent_until + delay, wire)
            return
        way.send(now + delay, wire)

    def _draw_silence(self, after: float) -> float:
        if not self._air.silences:
            return float("inf")
        return after + self._rng.exponential(60.0 / self._air.silences)
