"""A flight around the steps of a run: how a fleet gets ready, and how a body comes down whatever happens."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

from dcf_zenoh.algorithms.algorithm import Dialogue, Me
from dcf_zenoh.errors import DcfError, NeighbourLost, NotReady, PlantError, blaming
from dcf_zenoh.plant import Check, Pauses, Plant, State
from dcf_zenoh.records.writer import Recorder
from dcf_zenoh.requests import NEVER, Agree, Loop, Report, Start, Wait
from dcf_zenoh.rounds.exchange import Exchange
from dcf_zenoh.spec import nanoseconds

PHASES = ("prepare", "inspect", "agree", "arm", "take_off", "settle", "go_to_start")
START_LEAD = 50_000_000  # ns between the last agent's being ready and the common start
PHASE_TIME = 120_000_000_000  # ns that others may take for a phase
CONSENT_TIME = 900_000_000_000  # ns that a person may take to agree
_NOBODY = 2**53  # no id of an agent


def first_number(diameter: int) -> int:
    """The sequence number of an agent's first message: those of the agreement on the start begin with 0."""
    return -len(PHASES) * (diameter + 1)  # a phase takes so many rounds, and the word that it is over


class Flight:
    """The phases of one agent's flight.

    Args:
        me: The agent.
        plant: Its body.
        exchange: Its rounds with the neighbours.
        recorder: Its log.
        ready_timeout: Longest wait for the others to agree on the start, ns.
    """

    def __init__(self, me: Me, plant: Plant, exchange: Exchange, recorder: Recorder, ready_timeout: int) -> None:
        self._me = me
        self._plant = plant
        self._exchange = exchange
        self._recorder = recorder
        self._ready_timeout = ready_timeout
        self._checks: tuple[Check, ...] = ()
        self._off_the_ground = False  # or may be

    def begin(self) -> Loop[int]:
        """Get ready together with the fleet, phase by phase, and start; fleet time, ns.

        Raises:
            PlantError: The own body cannot go on; nobody does.
            NeighbourLost: Another one cannot.
            NotReady: Nobody agreed to the take-off, or the fleet did not agree on a start in time.
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
            if outcome.result != _NOBODY:
                raise NeighbourLost(
                    f"agent {self._me.id}: {words}: agent {outcome.result} cannot go on, so nobody does"
                )
        yield Report("start")
        now = yield from self._agree_on_start()
        with self._blaming("start"):
            self._plant.start(now)
        return now

    def join(self, last_state: State) -> Loop[int]:
        """Take part again in a run that is under way; fleet time, ns."""
        yield from self._go_through("prepare", self._plant.prepare)
        now = yield Wait(0)
        self._off_the_ground = True
        with self._blaming("resume"):
            self._plant.resume(last_state, now)
        return now

    def land(self, now: int, reason: str) -> Loop[int]:
        """Come down because of `reason`, whoever wants what meanwhile: a body that lands is not left alone.

        Returns:
            Fleet time, ns.

        Raises:
            PlantError: The plant raised an exception.
        """
        if not self._off_the_ground:
            return now
        self._off_the_ground = False
        if self._plant.landing_time:
            yield Report("land")
        with self._blaming("finish"):
            pauses = iter(self._plant.finish(now, reason) or ())
        while (pause := self._next("finish", pauses)) is not None:
            until = now + nanoseconds(pause)
            while now < until:
                try:
                    now = yield Wait(until)
                except DcfError:  # it is about to stop anyhow
                    continue
        return now

    def _perform(self, phase: str) -> Loop[PlantError | NotReady | None]:
        """Go through a phase; what keeps the body from going on."""
        yield Report(phase, self._checks)
        try:
            if phase == "agree":
                return (yield from self._agree())
            self._off_the_ground = self._off_the_ground or phase == "arm"
            yield from self._go_through(phase, getattr(self._plant, phase))
            return self._objection() if phase == "inspect" else None
        except PlantError as error:
            return error

    def _agree(self) -> Loop[NotReady | None]:
        """Ask a person whether real bodies may take off."""
        if not self._plant.real:
            return None
        now = yield Wait(0)
        if (yield Agree(now + CONSENT_TIME)) < 0:
            return NotReady(f"agent {self._me.id}: nobody agreed to the take-off within {CONSENT_TIME * 1e-9:g} s")
        return None

    def _objection(self) -> PlantError | None:
        """Look at what the inspection has found."""
        with self._blaming("checks"):
            self._checks = self._plant.checks()
        if self._checks:
            self._recorder.event("inspected", 0, checks=[list(check) for check in self._checks])
        problems = [f"{check.name} {check.value}: {check.problem}" for check in self._checks if check.problem]
        return PlantError(f"agent {self._me.id}: not ready to fly: {'; '.join(problems)}") if problems else None

    def _go_through(self, phase: str, perform: Callable[[], Pauses]) -> Loop[None]:
        """Go through a phase, and wait for as long as it asks for."""
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
        """Agree on the instant of the start: the latest that any agent proposes."""
        now = yield Wait(0)
        proposal = _latest(self._me, now + START_LEAD)
        outcome = yield from self._exchange.negotiate(proposal, -1, now, until=now + self._ready_timeout)
        if outcome.result is None:
            why = self._missing(self._ready_timeout)
            raise NotReady(f"agent {self._me.id}: the fleet did not agree on a start: {why}")
        return (yield Start(outcome.result))

    def _missing(self, timeout: int) -> str:
        """Why somebody was not heard."""
        lost = [f"neighbour {j} is lost ({how})" for j, how in self._exchange.lost_neighbours(0, NEVER).items()]
        return "; ".join(lost) or f"not everybody was heard within {timeout * 1e-9:g} s"


def _latest(me: Me, proposal: int) -> Dialogue[int | None]:
    """The largest proposal of the fleet; None if somebody was not heard, or there is no time left."""
    return (yield from _flood(me, "start", proposal, max))


def _refusing(me: Me, *, refuses: bool) -> Dialogue[int | None]:
    """The lowest id of those who refuse to go on, `_NOBODY` if all agree; None if somebody was not heard.

    An agent that waits here for all others knows that they have come as far as itself.
    """
    return (yield from _flood(me, "refuses", me.id if refuses else _NOBODY, min))


def _flood(me: Me, name: str, value: int, combine: Callable[..., int]) -> Dialogue[int | None]:
    """The largest or smallest value of the fleet, known to all after as many rounds as the graph's diameter."""
    diameter = me.neighbourhood.diameter
    for number in range(1, diameter + 1):
        inbox = yield {name: value}, float("inf")
        if inbox.missing or (inbox.stop and number < diameter):
            return None
        value = combine(value, *(int(inbox[j][name]) for j in inbox))
    return value
