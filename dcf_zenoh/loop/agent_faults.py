"""Node faults: slow computation, a pause and a crash of one agent, from the fleet file."""

from collections.abc import Callable
from typing import TypeVar

from dcf_zenoh.requests import NEVER, Activate, Loop, Publish, Request, Wait
from dcf_zenoh.spec import AgentFaults, nanoseconds

R = TypeVar("R")


class Crashed(Exception):
    """The agent has crashed, as its fleet file asks for. Not an error.

    Attributes:
        at: Fleet time, ns.
    """

    def __init__(self, at: int) -> None:
        self.at = at
        super().__init__(f"crashed at {at * 1e-9:g} s, as the fleet file says")


class NodeFaults:
    """Faults of one agent, applied to the requests of its loop. The loop itself does not know of them.

    Args:
        faults: Faults of the agent in the fleet file.
        away: Creates the message to the neighbours' runners that nothing is sent before an instant, from the present
            time and that instant, ns; None on the wall clock, where runners do not need it.
    """

    def __init__(self, faults: AgentFaults, away: Callable[[int, int], Publish] | None) -> None:
        crash, slow = faults.crash, faults.slow
        self._any = bool(faults)
        self._away = away
        self._pause = _window(faults.pause) if faults.pause else (NEVER, NEVER)
        self._crash_at = nanoseconds(crash.at) if crash else NEVER
        self._restart_after = nanoseconds(crash.restart_after) if crash and crash.restart_after else NEVER
        self._slow = _window(slow.during) if slow and slow.during else (0, NEVER)
        self._factor = slow.factor if slow else 1.0

    @property
    def announces(self) -> bool:
        """Whether the neighbours' runners need a message when nothing will be sent."""
        return self._away is not None

    @property
    def slowness(self) -> Callable[[int], float] | None:
        """Fleet time in ns -> factor by which computation takes longer then; None if it never does."""
        return self._slowness if self._factor != 1.0 else None

    def _slowness(self, now: int) -> float:
        return self._factor if self._slow[0] <= now < self._slow[1] else 1.0

    def back_at(self, crashed: int) -> int:
        """Return when an agent that crashed at the instant `crashed` restarts, ns."""
        return min(NEVER, crashed + self._restart_after)

    def lead(self, part: Loop[R]) -> Loop[R]:
        """Lead a part of the agent's loop: it ends at the instant of the crash, and stands still in the pause.

        Raises:
            Crashed: The agent crashes now.
        """
        if not self._any:
            return (yield from part)
        reply: int | None = None
        while True:
            try:
                request = part.send(reply)  # type: ignore[arg-type]
            except StopIteration as finished:
                result: R = finished.value
                return result
            reply = yield from self._ask(request)
            if reply >= self._crash_at:
                self._crash_at = NEVER
                part.close()
                raise Crashed(reply)

    def _ask(self, request: Request) -> Loop[int]:
        """Pass on a request, cut short at the crash and prolonged by the pause."""
        if isinstance(request, (Wait, Activate)) and request.until > self._crash_at:
            request = Wait(self._crash_at) if isinstance(request, Activate) else request._replace(until=self._crash_at)
        reply = yield request
        begin, end = self._pause
        if begin <= reply < end:
            self._pause = NEVER, NEVER
            if self._away is not None:
                yield self._away(reply, min(end, self._crash_at))  # a crash ends the pause
            again = Activate(end, request.senders) if isinstance(request, Activate) else Wait(end)
            reply = yield from self._ask(again)
        return reply


def _window(seconds: tuple[float, float]) -> tuple[int, int]:
    begin, end = seconds
    return nanoseconds(begin), nanoseconds(end)
