"""Phases of a flight around the control steps: preparation with phase barriers, agreement on the start, landing."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

from dcf_zenoh.algorithms.algorithm import Dialogue, Me
from dcf_zenoh.errors import DcfError, NeighbourLost, NotReady, PlantError, blaming
from dcf_zenoh.plant import Check, Pauses, Plant, State
from dcf_zenoh.records.log_writer import Recorder
from dcf_zenoh.requests import NEVER, Agree, Loop, Report, Start, Wait
from dcf_zenoh.rounds.exchange import Exchange
from dcf_zenoh.spec import nanoseconds

PHASES = ("prepare", "inspect", "agree", "arm", "take_off", "settle", "go_to_start")
START_LEAD = 50_000_000  # ns from the moment at which the last agent is ready to the common start
PHASE_TIME = 120_000_000_000  # ns, longest wait for the other agents at a phase barrier
CONSENT_TIME = 900_000_000_000  # ns, longest wait for a person's consent to the take-off
_NO_AGENT = 2**53  # larger than any id


def first_number(diameter: int) -> int:
    """Return the sequence number of an agent's first message; the agreement on the start begins with number 0."""
    return -len(PHASES) * (diameter + 1)  # a phase barrier takes `diameter` rounds and a message that it is over


class Flight:
    """Phases of one agent's flight.

    Args:
        me: The agent, as algorithms see it.
        plant: Its body.
        exchange: Its rounds with the neighbours.
        recorder: Its log.
        ready_timeout: Longest wait for the fleet's agreement on the start, ns.
    """

    def __init__(self, me: Me, plant: Plant, exchange: Exchange, recorder: Recorder, ready_timeout: int) -> None:
        self._me = me
        self._plant = plant
        self._exchange = exchange
        self._recorder = recorder
        self._ready_timeout = ready_timeout
        self._checks: tuple[Check, ...] = ()
        self._airborne = False  # True as soon as the body may be off the ground

    def begin(self) -> Loop[int]:
        """Go through the phases together with the fleet, and start; return fleet time, ns.

        If one agent cannot continue, the whole fleet stops.

        Raises:
            PlantError: This agent's body cannot continue.
            NeighbourLost: Another agent cannot continue.
            NotReady: No person agreed to the take-off, or the fleet did not agree on a start in time.
        """
        for number, phase in enumerate(PHASES):
            refusal = yield from self._perform(phase)
            now = yield Wait(0)
            timeout = CONSENT_TIME if phase == "agree" else PHASE_TIME
            outcome = yield from self._exchange.negotiate(
                _refusing(self._me, refuses=refusal is not None), number - len(PHASES) - 1, now, until=now + timeout
            )
            if refusal is not None:
                raise refusal
            words = phase.replace("_", " ")
            if outcome.result is None:
                raise NotReady(f"agent {self._me.id}: {words}: {self._missing(timeout)}")
            if outcome.result != _NO_AGENT:
                raise NeighbourLost(
                    f"agent {self._me.id}: {words}: agent {outcome.result} cannot go on, so nobody does"
                )
        yield Report("start")
        now = yield from self._agree_on_start()
        with self._blaming("start"):
            self._plant.start(now)
        return now

    def join(self, last_state: State) -> Loop[int]:
        """Join a run that has already started, after a restart; return fleet time, ns."""
        yield from self._go_through("prepare", self._plant.prepare)
        now = yield Wait(0)
        self._airborne = True
        with self._blaming("resume"):
            self._plant.resume(last_state, now)
        return now

    def land(self, now: int, reason: str) -> Loop[int]:
        """Land because of `reason`; requests to stop do not interrupt it.

        Returns:
            Fleet time, ns.

        Raises:
            PlantError: The plant raised an exception.
        """
        if not self._airborne:
            return now
        self._airborne = False
        if self._plant.landing_time:
            yield Report("land")
        with self._blaming("finish"):
            pauses = iter(self._plant.finish(now, reason) or ())
        while (pause := self._next("finish", pauses)) is not None:
            until = now + nanoseconds(pause)
            while now < until:
                try:
                    now = yield Wait(until)
                except DcfError:  # the agent is stopping already
                    continue
        return now

    def _perform(self, phase: str) -> Loop[PlantError | NotReady | None]:
        """Go through a phase; return the error that keeps the agent from continuing, if there is one."""
        yield Report(phase, self._checks)
        try:
            if phase == "agree":
                return (yield from self._agree_on_take_off())
            self._airborne = self._airborne or phase == "arm"
            yield from self._go_through(phase, getattr(self._plant, phase))
            return self._failed_checks() if phase == "inspect" else None
        except PlantError as error:
            return error

    def _agree_on_take_off(self) -> Loop[NotReady | None]:
        """Wait for a person's consent, if the body is real."""
        if not self._plant.real:
            return None
        now = yield Wait(0)
        if (yield Agree(now + CONSENT_TIME)) < 0:
            return NotReady(f"agent {self._me.id}: nobody agreed to the take-off within {CONSENT_TIME * 1e-9:g} s")
        return None

    def _failed_checks(self) -> PlantError | None:
        """Log the results of the inspection; return an error if a check failed."""
        with self._blaming("checks"):
            self._checks = self._plant.checks()
        if self._checks:
            self._recorder.event("inspected", 0, checks=[list(check) for check in self._checks])
        problems = [f"{check.name} {check.value}: {check.problem}" for check in self._checks if check.problem]
        return PlantError(f"agent {self._me.id}: not ready to fly: {'; '.join(problems)}") if problems else None

    def _go_through(self, phase: str, perform: Callable[[], Pauses]) -> Loop[None]:
        """Go through a phase of the plant, with the pauses that it yields."""
        now = yield Wait(0)
        with self._blaming(phase):
            pauses = iter(perform() or ())
        while (pause := self._next(phase, pauses)) is not None:
            now = yield Wait(now + nanoseconds(pause))

    def _next(self, phase: str, pauses: Iterator[float]) -> float | None:
        with self._blaming(phase):
            return next(pauses, None)

    def _blaming(self, phase: str) -> AbstractContextManager[None]:
        return blaming(PlantError, f"agent {self._me.id}: {phase.replace('_', ' ')}")

    def _agree_on_start(self) -> Loop[int]:
        """Agree with the fleet on the start, the latest instant that any agent proposes; return fleet time, ns."""
        now = yield Wait(0)
        proposal = _latest(self._me, now + START_LEAD)
        outcome = yield from self._exchange.negotiate(proposal, -1, now, until=now + self._ready_timeout)
        if outcome.result is None:
            why = self._missing(self._ready_timeout)
            raise NotReady(f"agent {self._me.id}: the fleet did not agree on a start: {why}")
        return (yield Start(outcome.result))

    def _missing(self, timeout: int) -> str:
        """Describe which agents are missing after a time-out."""
        lost = [f"neighbour {j} is lost ({how})" for j, how in self._exchange.lost_neighbours(0, NEVER).items()]
        return "; ".join(lost) or f"not everybody was heard within {timeout * 1e-9:g} s"


def _latest(me: Me, proposal: int) -> Dialogue[int | None]:
    """Return the largest proposal of the fleet; None if a message is missing or there is no time left."""
    return (yield from _flood(me, "start", proposal, max))


def _refusing(me: Me, *, refuses: bool) -> Dialogue[int | None]:
    """Return the lowest id of the agents that refuse to continue, `_NO_AGENT` if there are none.

    None if a message is missing. This is the phase barrier: it ends when all agents have reached it.
    """
    return (yield from _flood(me, "refuses", me.id if refuses else _NO_AGENT, min))


def _flood(me: Me, name: str, value: int, combine: Callable[..., int]) -> Dialogue[int | None]:
    """Return the largest or smallest value of the fleet, by flooding: it takes as many rounds as the graph's diameter.

    None if a message is missing or there is no time left.
    """
    diameter = me.neighbourhood.diameter
    for number in range(1, diameter + 1):
        inbox = yield {name: value}, float("inf")
        if inbox.missing or (inbox.stop and number < diameter):
            return None
        value = combine(value, *(int(inbox[j][name]) for j in inbox))
    return value
