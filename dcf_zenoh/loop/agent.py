"""Algorithm 1: the loop of every agent, on the wall clock and in virtual time, over Zenoh and in the simulator.

The loop does no I/O and reads no clock: it yields requests to its runner. Source: Memon et al., Algorithm 1.
"""

from collections.abc import Callable, Sequence
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
from dcf_zenoh.loop.supervisor import Alarm, Supervisor, gravest
from dcf_zenoh.message import Last
from dcf_zenoh.plant import Array, Plant, Setpoint, State
from dcf_zenoh.records.writer import Recorder, StepRecord
from dcf_zenoh.requests import NEVER, Loop, Wait
from dcf_zenoh.rounds.exchange import Exchange, Outcome
from dcf_zenoh.spec import Arrived, FleetSpec, nanoseconds


class Ending(NamedTuple):
    """How an agent's run ended.

    Attributes:
        last: Done, arrived, or landed before its time.
        cause: Why it landed before its time.
    """

    last: Last
    cause: Landed | NeighbourLost | None = None


class Agent:
    """One agent: what it senses, decides and does, step by step.

    Args:
        fleet: What all agents do.
        me: This one.
        plant: Its body.
        renew: Makes its controller, without any memory of an earlier one.
        exchange: Its rounds with the neighbours.
        recorder: Its log.
        distance_to_go: State -> distance to the target, m.
        fate: What shall happen to it.
        last_life: The last state that is known of it, if it was started again while the fleet was running.
    """

    def __init__(
        self,
        fleet: FleetSpec,
        me: Me,
        plant: Plant,
        renew: Callable[[], Controller],
        exchange: Exchange,
        recorder: Recorder,
        distance_to_go: Callable[[State], float],
        fate: NodeFaults,
        last_life: State | None = None,
    ) -> None:
        self._fleet = fleet
        self._me = me
        self._plant = plant
        self._renew = renew
        self._controller = renew()
        self._exchange = exchange
        self._recorder = recorder
        self._distance_to_go = distance_to_go
        self._fate = fate
        self._last_life = last_life
        self._sample_time = nanoseconds(fleet.time.sample_time)
        self._budget = nanoseconds(fleet.exchange.step_budget(fleet.time.sample_time))
        self._arrival = Arrival(fleet.time.arrived)
        self._supervisor = Supervisor(fleet.safety, fleet.arena, fleet.time.sample_time)
        self._flight = Flight(me, plant, exchange, recorder, nanoseconds(fleet.zenoh.ready_timeout))
        self._lost: dict[int, str] = {}
        self._holding = ""
        self._why_landed: Landed | NeighbourLost | None = None

    def run(self) -> Loop[Ending]:
        """The whole run: get ready, control step by step, come down, say goodbye.

        Returns:
            Why it ended.

        Raises:
            NotReady: Not all of the fleet got ready, or it did not agree on a start in time.
            NumericalError: A plant or a controller produced a value that is not a number.
            PlantError: The plant raised an exception, or the body was not seen to come down after a failure.
            AlgorithmError: The algorithm, or the problem or controller around it, raised an exception.
            Stopped: Somebody wanted the agent to stop.
        """
        try:
            step, last = yield from self._fly()
            now = yield Wait(step * self._sample_time)
            state = self._last_state(now)
        except Exception as error:
            if in_the_air := (yield from self._come_down(error)):
                raise PlantError(f"{error}; then {in_the_air}") from error
            raise
        yield self._exchange.goodbye(step, now, last)
        reason = last.name.lower()
        now = yield from self._flight.land(now, reason)
        remark = str(self._why_landed or self._holding)
        self._recorder.end(reason, now, state, remark, self._exchange.counts, self._exchange.unmet)
        return Ending(last, self._why_landed)

    def _last_state(self, now: int) -> State:
        """The state at the end; of a body that had to come down, which may be able to say nothing any more, none."""
        if self._why_landed:
            return State()
        with blaming(PlantError, f"agent {self._me.id}: sense"):
            return self._plant.sense(now)

    def _fly(self) -> Loop[tuple[int, Last]]:
        """Begin, and control step by step; the first step that is not taken, and why it is not."""
        step = yield from self._begin()
        reason: Last | None = None
        while step < self._fleet.steps and reason is None:
            try:
                reason = yield from self._fate.lead(self._step(step))
                step += 1
            except Crashed as crash:
                step = yield from self._lie_dead(crash, step)
        return step, reason or Last.DONE

    def _begin(self) -> Loop[int]:
        """Start with the fleet, or join it when it is under way already; the first step."""
        if self._last_life is None:
            yield from self._flight.begin()
            return 0
        now = yield from self._flight.join(self._last_life)
        step = now // self._sample_time + 1
        self._recorder.event("joined", now, step=step)
        return step

    def _come_down(self, error: Exception) -> Loop[PlantError | None]:
        """Say goodbye after a failure, land, and end the log; what went wrong with the landing."""
        reason, remark, now = "stopped" if isinstance(error, Stopped) else "failed", str(error), 0
        problem: PlantError | None = None
        try:
            now = yield self._exchange.goodbye(NEVER, 0, Last.FAILED)
        except Exception as another:  # nobody hears it; the body lands all the same
            remark += f"; then {another}"
        try:
            yield from self._flight.land(now, reason)
        except PlantError as another:
            problem = another
            remark += f"; then {another}"
        self._recorder.end(reason, -1, State(), remark, self._exchange.counts, self._exchange.unmet)
        return problem

    def _step(self, step: int) -> Loop[Last | None]:
        """One turn of the loop; the reason to end, if there is one."""
        due = step * self._sample_time
        place = f"agent {self._me.id}: step {step}"
        now = yield Wait(due)  # 4 synchronise
        with blaming(PlantError, f"{place}: sense"):
            state = _finite(self._plant.sense(now), place)  # 3 sense
        if last := self._react("body", self._supervisor.body(state), step, now):
            self._recorder.step(StepRecord.abstained(step, now, state, Setpoint.hold(state), str(self._why_landed)))
            return last
        if self._holding:
            yield self._exchange.abstain(step, now, due + self._sample_time)
            setpoint = Setpoint.hold(state)
            with blaming(PlantError, f"{place}: act"):
                self._plant.act(setpoint, now)
            self._recorder.step(StepRecord.abstained(step, now, state, setpoint, self._holding))
            return None
        sensed = now
        with blaming(AlgorithmError, place):
            arrived = self._arrival.update(now, self._distance_to_go(state))
            dialogue = self._controller.control(state, step)
        outcome = yield from self._exchange.negotiate(  # 1 communicate, 2 compute
            dialogue,
            step,
            now,
            until=due + self._budget,
            next_step=due + self._sample_time,
            arrived=arrived,
            here=tuple(state.position.tolist()),
        )
        now = outcome.now
        with blaming(AlgorithmError, f"{place} round {outcome.rounds}"):
            setpoint, late = self._in_time(outcome, state, late=now > due + self._sample_time)
        setpoint, alarms = self._supervised(setpoint, state, outcome, late=late, place=place)
        if not late and (moment := due + nanoseconds(self._controller.acts_after)) > now:
            now = yield Wait(moment)
        last = self._react("decision", alarms, step, now)
        if last or self._holding:
            setpoint = Setpoint.hold(state)
        if not last:
            with blaming(PlantError, f"{place}: act"):
                self._plant.act(setpoint, now)  # 3 act
        remark = self._watch_neighbours(step, now)
        record = StepRecord.of(step, sensed, state, now, setpoint, outcome, late=late, remark=remark)
        self._recorder.step(record)  # 5 log
        if outcome.all_arrived or self._exchange.departed(Last.ARRIVED):
            return Last.ARRIVED
        silent = self._supervisor.neighbours([f"neighbour {j} is lost ({how})" for j, how in self._lost.items()])
        return last or self._react("neighbours", silent, step, now)

    def _supervised(
        self, setpoint: Setpoint, state: State, outcome: Outcome[Decision], *, late: bool, place: str
    ) -> tuple[Setpoint, list[Alarm]]:
        """The setpoint within its limits, and what the supervisor has to say of the step.

        Raises:
            NumericalError: It is not finite, and nothing else shall follow from that.
        """
        if problem := _unsound(setpoint, outcome):
            text = f"round {outcome.rounds}: {problem}"
            if self._fleet.safety.not_finite == "land":
                raise NumericalError(f"{place} {text}")
            return Setpoint.hold(state), self._supervisor.not_finite(text)
        setpoint, alarms = self._supervisor.setpoint(setpoint, state)
        alarms += self._supervisor.separation(state, self._exchange.positions)
        alarms += self._supervisor.deadline(late=late)
        if late and self._fleet.exchange.late == "land":
            alarms.append(Alarm("late", "land", "the step overran, and exchange.late says land"))
        return setpoint, alarms

    def _react(self, look: str, alarms: Sequence[Alarm], step: int, now: int) -> Last | None:
        """Note what is new, and do what follows; how the flight ends, if it does."""
        for alarm in self._supervisor.fresh(look, alarms):
            self._recorder.event("alarm", now, step=step, **alarm._asdict())
        worst = gravest(alarms)
        if worst is None or worst.then in ("log", "clip"):
            return None
        if worst.then == "hold":
            self._holding = self._holding or worst.text
            return None
        if worst.then == "stop":
            self._plant.emergency_stop()
        cause = NeighbourLost if worst.rule == "neighbour_silent" else Landed
        self._why_landed = cause(f"agent {self._me.id}: step {step}: {worst.text}")
        return Last.LANDED

    def _in_time(self, outcome: Outcome[Decision], state: State, *, late: bool) -> tuple[Setpoint, bool]:
        """The setpoint that flies, and whether the step overran."""
        setpoint = outcome.result.setpoint
        if setpoint is not None and not late:
            return setpoint, False
        planned = self._controller.next_of_plan() if self._fleet.exchange.late == "previous_plan" else None
        return planned or Setpoint.hold(state), True

    def _watch_neighbours(self, step: int, now: int) -> str:
        """See who is lost, and who is back; what there is to say about it."""
        lost = self._exchange.lost_neighbours(step, now, nanoseconds(self._fleet.safety.neighbour_silent.after))
        news = [f"neighbour {j} is lost ({how})" for j, how in lost.items() if j not in self._lost]
        news += [f"neighbour {j} is back" for j in self._lost if j not in lost]
        self._lost = lost
        return "; ".join(news)

    def _lie_dead(self, crash: Crashed, step: int) -> Loop[int]:
        """Do nothing until the restart: the body comes to rest. The step from which this agent takes part again."""
        back = self._fate.back_at(crash.at)
        first = step if crash.at < step * self._sample_time else step + 1  # it may have died before the step began
        again = min(self._fleet.steps, max(first, -(-back // self._sample_time)))
        if self._fate.announces:
            yield self._exchange.away(again, crash.at, again * self._sample_time)
        self._recorder.event("crashed", crash.at, step=step)
        with blaming(PlantError, f"agent {self._me.id}: step {step}: sense"):
            state = self._plant.sense(crash.at)
        setpoint = Setpoint.hold(state)
        with blaming(PlantError, f"agent {self._me.id}: step {step}: act"):
            self._plant.act(setpoint, crash.at)
        if again > step:
            heard = self._exchange.cut_short(step)
            self._recorder.step(StepRecord.abstained(step, crash.at, state, setpoint, str(crash), *heard))
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
    """Whether an agent has been near its target for long enough.

    Args:
        rule: How near and how long; None: nobody ever arrives.
    """

    def __init__(self, rule: Arrived | None) -> None:
        self._rule = rule
        self._since: int | None = None

    def update(self, now: int, distance: float) -> bool:
        """Take in the `distance` to the target, in m, at `now`, in ns."""
        if self._rule is None or distance > self._rule.within:
            self._since = None
            return False
        if self._since is None:
            self._since = now
        return now - self._since >= nanoseconds(self._rule.for_)


def _finite(state: State, place: str) -> State:
    if not np.isfinite(state.vector).all():
        raise NumericalError(f"{place}: the plant's state is not finite: {_show(state.vector)}")
    return state


def _unsound(setpoint: Setpoint, outcome: Outcome[Decision]) -> str:
    """What is not finite: a decision, or a setpoint made from it; empty if all is well."""
    flown = setpoint.vector if setpoint.acceleration is not None else setpoint.position
    for what, vector in (("the algorithm's decision", outcome.result.value), ("the controller's setpoint", flown)):
        if not np.isfinite(vector).all():
            return f"{what} is not finite: {_show(vector)}"
    return ""


def _show(vector: Array) -> str:
    return np.array2string(vector, precision=4, threshold=12)
