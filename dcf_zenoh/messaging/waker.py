"""A time-out for a blocking call that has none."""

import threading
import time
from collections.abc import Callable
from math import inf


class Waker:
    """Wakes one thread out of a blocking call at a deadline, or when something happens.

    Reading a Zenoh channel blocks without a time-out, but costs half of what a callback does (docs/performance.md).
    So a second thread makes the awaited channel deliver something when the time has come. It sleeps through rounds
    that end before their deadline.

    Args:
        wake: Called from another thread with the target of the blocking call, to end that call. It may come too late,
            so that the next call is woken without need.
    """

    def __init__(self, wake: Callable[[int], None]) -> None:
        self._wake = wake
        self._changed = threading.Condition()  # guards _due and _poked; _blocked belongs to the caller
        self._blocked: tuple[int, float] | None = None
        self._due = inf  # when the thread looks at _blocked, monotonic s; never later than the caller's deadline
        self._poked = False
        self._closed = False
        self._thread = threading.Thread(target=self._watch, name="waker", daemon=True)
        self._thread.start()

    def arm(self, target: int, deadline: float) -> None:
        """Guard a blocking call on `target` that the caller is about to make, until `deadline` (monotonic s)."""
        self._blocked = target, deadline
        if deadline < self._due:
            with self._changed:
                self._due = deadline
                self._changed.notify()

    def disarm(self) -> None:
        """End the guard: the blocking call is over."""
        self._blocked = None

    def poke(self) -> None:
        """Wake the caller now, if it blocks. Callable from any thread and from signal handlers."""
        with self._changed:
            self._poked = True
            self._changed.notify()

    def close(self) -> None:
        """End the thread."""
        self._closed = True
        self.poke()
        self._thread.join()

    def _watch(self) -> None:
        with self._changed:
            while not self._closed:
                now, previous = time.monotonic(), self._due
                self._due = inf  # from here on `arm` takes the lock, which it gets when this thread waits again
                blocked = self._blocked
                if blocked is None:
                    self._due = previous if previous > now else inf
                elif self._poked or now >= blocked[1]:
                    self._wake(blocked[0])
                else:
                    self._due = blocked[1]
                self._poked = False
                self._changed.wait(min(self._due - now, threading.TIMEOUT_MAX))
