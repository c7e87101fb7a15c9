"""Algorithm 1: the loop of every agent, on the wall clock and in virtual time, over Zenoh and in the simulator.

The loop does no I/O and reads no clock: it yields requests to its runner. Source: Memon et al., Algorithm 1.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dcf_zenoh.algorithms.algorithm import Me
from dcf_zenoh.controllers.controller import Controller, Decision
from dcf_zenoh.errors import (
    AlgorithmError,
    Landed,
    NeighbourLost,
    NumericalError,
    PlantError,
    Stopped,
    blaming,
)
from dcf_zenoh.loop.agent_faults import Crashed, NodeFaults
from dcf_zenoh.loop.phases import Flight
from dcf_zenoh.loop.supervisor import Alarm, Supervisor, most_severe
from dcf_zenoh.message import Last
from dcf_zenoh.plant import Array, Plant, Setpoint, State
from dcf_zenoh.records.log_writer import Recorder, StepRecord
from dcf_zenoh.requests import NEVER, Loop, Wait
from dcf_zenoh.rounds.exchange import Exchange, Outcome
from dcf_zenoh.spec import Arrived, FleetSpec, nanoseconds


class Ending(NamedTuple):
    """End of an agent's run.

    Attributes:
        last: Kind of the goodbye: done, arrived, or landed early.
        cause: Why it landed early.
    """

    last: Last
    cause: Landed | NeighbourLost | None = None


@dataclass(frozen=True)
class AgentOptions:
    """Options of one agent of a fleet, in addition to its parts.

    Attributes:
        distance_to_go: State -> distance to the target, m.
        node_faults: Faults of the agent itself.
        barrier: Own position and another agent's -> barrier value h of the safety region; None: there is none.
        last_state: Last state of an agent that was restarted while its fleet was running; None: it starts with the
            fleet.
    """

    distance_to_go: Callable[[State], float]
    node_faults: NodeFaults
    barrier: Callable[[Array, Array], Array] | None = None
    last_state: State | None = None


class Agent:
    """One agent: senses, decides and acts, step by step.

    Args:
        fleet: Specification of the fleet.
        me: This agent, as algorithms see it.
        plant: Its body.
        renew: Creates its controller, without memory of an earlier one.
        exchange: Its rounds with the neighbours.
        recorder: Its log.
        options: Further options of this agent.
    """

    def __init__(
        self,
        fleet: FleetSpec,
        me: Me,
        plant: Plant,
        renew: Callable[[], Controller],
        exchange: Exchange,
        recorder: Recorder,
        options: AgentOptions,
    ) -> None:
        self._fleet = fleet
        self._me = me
        self._plant = plant
        self._renew = renew
        self._controller = renew()
        self._exchange = exchange
        self._recorder = recorder
        self._options = options
        self._sample_time = nanoseconds(fleet.time.sample_time)
        self._budget = nanoseconds(fleet.exchange.step_budget(fleet.time.sample_time))
        self._arrival = Arrival(fleet.time.arrived)
        self._supervisor = Supervisor(fleet.safety, fleet.arena, fleet.time.sample_time, options.barrier)
        self._flight = Flight(me, plant, exchange, recorder, nanoseconds(fleet.zenoh.ready_timeout))
        self._lost: dict[int, str] = {}
        self._hold_reason = ""  # set once the reaction to an alarm is hold: from then on the body stays where it is
        self._landing_cause: Landed | NeighbourLost | None = None

    def run(self) -> Loop[Ending]:
        """Run from the preparation to the landing, with a goodbye to the neighbours.

        Returns:
            How the run ended.

        Raises:
            NotReady: Not all of the fleet got ready, or it did not agree on a start in time.
            NumericalError: A plant or a controller produced a value that is not a number.
            PlantError: The plant raised an exception, or the landing after a failure was not confirmed.
            AlgorithmError: The algorithm, the problem or the controller raised an exception.
            Stopped: The agent was stopped from outside.
        """
        try:
            step, last = yield from self._control()
            now = yield Wait(step * self._sample_time if self._keeps_time else 0)
            state = self._last_state(now)
        except Exception as error:
            if landing_error := (yield from self._end_after(error)):
                raise PlantError(f"{error}; then {landing_error}") from error
            raise
        yield self._exchange.goodbye(step, now, last)
        reason = last.name.lower()
        now = yield from self._flight.land(now, reason)
        remark = str(self._landing_cause or self._hold_reason)
        self._recorder.end(reason, now, state, remark, self._exchange.counts, self._exchange.unmet)
        return Ending(last, self._landing_cause)

    @property
    def _keeps_time(self) -> bool:
        """Whether the last step lasts a control period: not on the wall clock if nothing moves."""
        return self._fleet.has_plants or self._fleet.time.clock == "virtual"

    def _last_state(self, now: int) -> State:
        """Return the state at the end; empty after an early landing, when the plant may be unable to sense."""
        if self._landing_cause:
            return State()
        with blaming(PlantError, f"agent {self._me.id}: sense"):
            return self._plant.sense(now)

    def _control(self) -> Loop[tuple[int, Last]]:
        """Begin, and control step by step; return the first step that is not taken, and the kind of goodbye."""
        step = yield from self._begin()
        reason: Last | None = None
        while step < self._fleet.steps and reason is None:
            try:
                reason = yield from self._options.node_faults.lead(self._step(step))
                step += 1
            except Crashed as crash:
                step = yield from self._crashed(crash, step)
        return step, reason or Last.DONE

    def _begin(self) -> Loop[int]:
        """Start with the fleet, or join it while it is running; return the first step."""
        if self._options.last_state is None:
            yield from self._flight.begin()
            return 0
        now = yield from self._flight.join(self._options.last_state)
        step = now // self._sample_time + 1
        self._recorder.event("joined", now, step=step)
        return step

    def _end_after(self, error: Exception) -> Loop[PlantError | None]:
        """Say goodbye after a failure, land, and end the log; return the error of the landing, if there is one."""
        reason, remark, now = "stopped" if isinstance(error, Stopped) else "failed", str(error), 0
        landing_error: PlantError | None = None
        try:
            now = yield self._exchange.goodbye(NEVER, 0, Last.FAILED)
        except Exception as another:  # the body lands even if the goodbye cannot be sent
            remark += f"; then {another}"
        try:
            yield from self._flight.land(now, reason)
        except PlantError as another:
            landing_error = another
            remark += f"; then {another}"
        self._recorder.end(reason, -1, State(), remark, self._exchange.counts, self._exchange.unmet)
        return landing_error

    def _step(self, step: int) -> Loop[Last | None]:
        """Do one control step; return the kind of goodbye if the run ends with it."""
        due = step * self._sample_time
        place = f"agent {self._me.id}: step {step}"
        now = yield Wait(due)  # 4 synchronise
        with blaming(PlantError, f"{place}: sense"):
            state = _finite(self._plant.sense(now), place)  # 3 sense
        if last := self._react("body", self._supervisor.body(state), step, now):
            self._recorder.step(StepRecord.abstained(step, now, state, Setpoint.hold(state), str(self._landing_cause)))
            return last
        if self._hold_reason:
            yield self._exchange.abstain(step, now, due + self._sample_time)
            self._hold(step, now, state)
            return None
        sensed = now
        with blaming(AlgorithmError, place):
            arrived = self._arrival.update(now, self._options.distance_to_go(state))
            dialogue = self._controller.control(state, step)
        outcome = yield from self._exchange.negotiate(  # 1 communicate, 2 compute
            dialogue,
            step,
            now,
            until=due + self._budget,
            next_step=due + self._sample_time,
            arrived=arrived,
            position=tuple(state.position.tolist()),
        )
        now = outcome.now
        with blaming(AlgorithmError, f"{place} round {outcome.rounds}"):
            setpoint, late = self._in_time(outcome, state, late=now > due + self._sample_time)
        setpoint, alarms = self._supervised(setpoint, state, outcome, step, late=late)
        if not late and (moment := due + nanoseconds(self._controller.acts_after)) > now:
            now = yield Wait(moment)
        last = self._react("decision", alarms, step, now)
        if last or self._hold_reason:
            setpoint = Setpoint.hold(state)
        if not last:
            with blaming(PlantError, f"{place}: act"):
                self._plant.act(setpoint, now)  # 3 act
        remark = self._update_lost(now)
        record = StepRecord.of(step, sensed, state, now, setpoint, outcome, late=late, remark=remark)
        self._recorder.step(record)  # 5 log
        return self._after(outcome, step, now, last)

    def _hold(self, step: int, now: int, state: State) -> None:
        """Stay where the body is, without a negotiation."""
        setpoint = Setpoint.hold(state)
        with blaming(PlantError, f"agent {self._me.id}: step {step}: act"):
            self._plant.act(setpoint, now)
        self._recorder.step(StepRecord.abstained(step, now, state, setpoint, self._hold_reason))

    def _after(self, outcome: Outcome[Decision], step: int, now: int, last: Last | None) -> Last | None:
        """Return the kind of goodbye if the run ends after this step.

        Args:
            outcome: Outcome of the negotiation.
            step: Control step k.
            now: Fleet time, ns.
            last: Kind of goodbye that follows from the alarms so far.
        """
        if outcome.all_arrived or (self._arrival.ever and self._exchange.departed(Last.ARRIVED)):
            return Last.ARRIVED
        silent = self._supervisor.neighbours([f"neighbour {j} is lost ({how})" for j, how in self._lost.items()])
        return last or self._react("neighbours", silent, step, now)

    def _supervised(
        self, setpoint: Setpoint, state: State, outcome: Outcome[Decision], step: int, *, late: bool
    ) -> tuple[Setpoint, list[Alarm]]:
        """Return the setpoint within its limits, and the supervisor's alarms on this step.

        Raises:
            NumericalError: The setpoint is not finite, and `safety.not_finite` is "land".
        """
        if problem := _unsound(setpoint, outcome):
            text = f"round {outcome.rounds}: {problem}"
            if self._fleet.safety.not_finite == "land":
                raise NumericalError(f"agent {self._me.id}: step {step} {text}")
            return Setpoint.hold(state), self._supervisor.not_finite(text)
        setpoint, alarms = self._supervisor.setpoint(setpoint, state)
        alarms += self._supervisor.separation(state, self._exchange.positions, step)
        alarms += self._supervisor.deadline(late=late)
        alarms += self._supervisor.payloads(self._me.take_misshapen())
        if late and self._fleet.exchange.late == "land":
            alarms.append(Alarm("late", "land", "the step overran, and exchange.late says land"))
        return setpoint, alarms

    def _react(self, check: str, alarms: Sequence[Alarm], step: int, now: int) -> Last | None:
        """Log new alarms and carry out the most severe reaction; return the kind of goodbye if that ends the run.

        Args:
            check: Name of the check that gave the alarms; see `Supervisor.fresh`.
            alarms: Its alarms.
            step: Control step k.
            now: Fleet time, ns.
        """
        for alarm in self._supervisor.fresh(check, alarms):
            self._recorder.event("alarm", now, step=step, **alarm._asdict())
        worst = most_severe(alarms)
        if worst is None or worst.then in ("log", "clip"):
            return None
        if worst.then == "hold":
            self._hold_reason = self._hold_reason or worst.text
            return None
        if worst.then == "stop":
            self._plant.emergency_stop()
        cause = NeighbourLost if worst.rule == "neighbour_silent" else Landed
        self._landing_cause = cause(f"agent {self._me.id}: step {step}: {worst.text}")
        return Last.LANDED

    def _in_time(self, outcome: Outcome[Decision], state: State, *, late: bool) -> tuple[Setpoint, bool]:
        """Return the setpoint to fly, and whether the step overran."""
        setpoint = outcome.result.setpoint
        if setpoint is not None and not late:
            return setpoint, False
        planned = self._controller.next_of_plan() if self._fleet.exchange.late == "previous_plan" else None
        return planned or Setpoint.hold(state), True

    def _update_lost(self, now: int) -> str:
        """Find out which neighbours are lost; return the changes, in words."""
        silent_after = nanoseconds(self._fleet.safety.neighbour_silent.after)
        confirmed_after = self._sample_time // 2 if self._fleet.time.clock == "wall" else 0  # in the next step
        lost = self._exchange.lost_neighbours(now, silent_after, confirmed_after)
        news = [f"neighbour {j} is lost ({how})" for j, how in lost.items() if j not in self._lost]
        news += [f"neighbour {j} is back" for j in self._lost if j not in lost]
        self._lost = lost
        return "; ".join(news)

    def _crashed(self, crash: Crashed, step: int) -> Loop[int]:
        """Do nothing from a crash until the restart, while the body comes to rest; return the next step to take."""
        node_faults = self._options.node_faults
        back = node_faults.back_at(crash.at)
        first = step if crash.at < step * self._sample_time else step + 1  # it may have crashed before the step began
        again = min(self._fleet.steps, max(first, -(-back // self._sample_time)))
        if node_faults.announces:
            yield self._exchange.away(again, crash.at, again * self._sample_time)
        self._recorder.event("crashed", crash.at, step=step)
        with blaming(PlantError, f"agent {self._me.id}: step {step}: sense"):
            state = self._plant.sense(crash.at)
        setpoint = Setpoint.hold(state)
        with blaming(PlantError, f"agent {self._me.id}: step {step}: act"):
            self._plant.act(setpoint, crash.at)
        if again > step:
            links, passed = self._exchange.cut_short(step)
            self._recorder.step(StepRecord.abstained(step, crash.at, state, setpoint, str(crash), links, passed))
        for missed in range(step + 1, again):
            now = yield Wait(missed * self._sample_time)
            with blaming(PlantError, f"agent {self._me.id}: step {missed}: sense"):
                state = self._plant.sense(now)
            self._recorder.step(StepRecord.abstained(missed, now, state, Setpoint.hold(state), str(crash)))
        if again < self._fleet.steps:
            self._controller = self._renew()
            self._arrival = Arrival(self._fleet.time.arrived)
            self._recorder.event("restarted", again * self._sample_time, step=again)
        return again


class Arrival:
    """Arrival of an agent: it has been near its target for long enough.

    Args:
        rule: Distance and duration; None: the agent never arrives.

    Attributes:
        ever: Whether the agent has arrived before. Otherwise no fleet of its own can have arrived, whatever a message
            says.
    """

    def __init__(self, rule: Arrived | None) -> None:
        self._rule = rule
        self._since: int | None = None
        self.ever = False

    def update(self, now: int, distance: float) -> bool:
        """Take in the `distance` to the target, m, at `now`, ns; return whether the agent has arrived."""
        if self._rule is None or distance > self._rule.within:
            self._since = None
            return False
        if self._since is None:
            self._since = now
        arrived = now - self._since >= nanoseconds(self._rule.for_)
        self.ever = self.ever or arrived
        return arrived


def _finite(state: State, place: str) -> State:
    if not isinstance(state, State):
        raise PlantError(f"{place}: sense returned a {type(state).__name__}; expected State(position, velocity)")
    if not np.isfinite(state.vector).all():
        raise NumericalError(f"{place}: the plant's state is not finite: {_show(state.vector)}")
    return state


def _unsound(setpoint: Setpoint, outcome: Outcome[Decision]) -> str:
    """Describe what is not finite: the decision, or the setpoint made from it; empty if both are."""
    flown = setpoint.vector if setpoint.acceleration is not None else setpoint.position
    for what, vector in (("the algorithm's decision", outcome.result.value), ("the controller's setpoint", flown)):
        if not np.isfinite(vector).all():
            return f"{what} is not finite: {_show(vector)}"
    return ""


def _show(vector: Array) -> str:
    return np.array2string(vector, precision=4, threshold=12)
