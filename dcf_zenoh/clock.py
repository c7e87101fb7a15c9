"""Clocks of fleet time, in ns since the common start."""

import time


class WallClock:
    """Real time: ns UTC before the start, monotonic time since the start after it.

    The agreed instant of the start is mapped to this machine's monotonic clock once. Later changes of the system clock
    have no effect.
    """

    def __init__(self) -> None:
        self._origin: int | None = None

    def now(self) -> int:
        """Return fleet time, ns."""
        return time.time_ns() if self._origin is None else time.monotonic_ns() - self._origin

    def deadline(self, instant: int) -> float:
        """Convert a fleet time, ns, to a time of this machine's monotonic clock, s."""
        origin = time.monotonic_ns() - time.time_ns() if self._origin is None else self._origin
        return (instant + origin) * 1e-9

    def start(self, instant: int) -> None:
        """Set fleet time 0 to `instant`, ns UTC."""
        self._origin = time.monotonic_ns() + instant - time.time_ns()


class VirtualClock:
    """Virtual time: it passes only where the model lets it."""

    def __init__(self) -> None:
        self._now = 0

    def now(self) -> int:
        """Return fleet time, ns."""
        return self._now

    def start(self, instant: int) -> None:  # noqa: ARG002
        """Set fleet time to 0, whatever the real time `instant` is."""
        self._now = 0

    def advance(self, until: int) -> int:
        """Let time pass until `until`, ns, but never back; return the new time."""
        self._now = max(self._now, until)
        return self._now
