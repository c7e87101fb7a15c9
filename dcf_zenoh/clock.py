"""Fleet time, in ns since the common start."""

import time


class WallClock:
    """Real time. Before the start, ns UTC; after it, monotonic time since the start.

    The agreed instant is mapped to this machine's monotonic clock once, so later steps of the system clock do
    not matter.
    """

    def __init__(self) -> None:
        self._origin: int | None = None

    def now(self) -> int:
        """Fleet time, ns."""
        return time.time_ns() if self._origin is None else time.monotonic_ns() - self._origin

    def deadline(self, instant: int) -> float:
        """A fleet time as a time of this machine's monotonic clock, s."""
        origin = time.monotonic_ns() - time.time_ns() if self._origin is None else self._origin
        return (instant + origin) * 1e-9

    def start(self, instant: int) -> None:
        """Let fleet time be 0 at `instant`, ns UTC."""
        self._origin = time.monotonic_ns() + instant - time.time_ns()


class VirtualClock:
    """Time that passes only when the model says so."""

    def __init__(self) -> None:
        self._now = 0

    def now(self) -> int:
        """Fleet time, ns."""
        return self._now

    def start(self, instant: int) -> None:  # noqa: ARG002
        """The model starts at 0, whenever that is."""
        self._now = 0

    def advance(self, until: int) -> int:
        """Let time pass until `until`, ns; it never goes back. The new time."""
        self._now = max(self._now, until)
        return self._now
