"""Algorithm 1: the loop of every agent, on the wall clock and in virtual time, over Zenoh and in the simulator.

The loop does no I/O and reads no clock: it yields requests to its runner. Source: Memon et al., Algorithm 1.
"""

from collections.abc import Callable

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me
from dcf_zenoh.controllers.controller import Controller, Decision
from dcf_zenoh.errors import AlgorithmError, NeighbourLost, NotReady, NumericalError, PlantError, blaming
from dcf_zenoh.exchange import Exchange, Outcome
from dcf_zenoh.messaging.message import Last
from dcf_zenoh.plant import Array, Plant, Setpoint, State
from dcf_zenoh.recording import Recorder, StepRecord
from dcf_zenoh.requests import Loop, Start, Wait
from dcf_zenoh.spec import Arrived, FleetSpec, nanoseconds

START_LEAD = 50_000_000  # ns between the last agent's being ready and the common start


def agent(
    fleet: FleetSpec,
    me: Me,
    plant: Plant,
    controller: Controller,
    exchange: Exchange,
    recorder: Recorder,
    distance_to_go: Callable[[State], float],
) -> Loop[Last]:
    """One agent's whole run: agree on the start, control step by step, say goodbye.

    Returns:
        Why it ended: `Last.DONE` or `Last.ARRIVED`.

    Raises:
        NotReady: The fleet did not agree on a start in time.
        NeighbourLost: A neighbour was lost, and the fleet file says stop.
        NumericalError: A plant or a controller produced a value that is not a number.
        PlantError: The plant raised an exception.
        AlgorithmError: The algorithm, or the problem or controller around it, raised an exception.
    """
    sample_time = nanoseconds(fleet.time.sample_time)
    budget = nanoseconds(fleet.exchange.step_budget(fleet.time.sample_time))
    silent = fleet.safety.neighbour_silent
    arrival = Arrival(fleet.time.arrived)
    steps = fleet.steps
    holding = ""
    reason = Last.DONE

    now = yield from _start(me, exchange, nanoseconds(fleet.zenoh.ready_timeout))
    with blaming(PlantError, f"agent {me.id}: start"):
        plant.start(now)
    for step in range(steps):
        due = step * sample_time
        place = f"agent {me.id}: step {step}"
        now = yield Wait(due)  # 4 synchronise
        with blaming(PlantError, f"{place}: sense"):
            state = _finite(plant.sense(now), place)  # 3 sense
        sensed = now
        if holding:
            yield exchange.abstain(step, now)
            with blaming(PlantError, f"{place}: act"):
                plant.act(Setpoint.hold(state), now)
            recorder.step(StepRecord.abstained(step, sensed, state, Setpoint.hold(state), holding))
            continue
        with blaming(AlgorithmError, place):
            settled = arrival.update(now, distance_to_go(state))
            dialogue = controller.control(state)
        outcome = yield from exchange.negotiate(  # 1 communicate, 2 compute
            dialogue, step, now, until=due + budget, settled=settled
        )
        now = outcome.now
        with blaming(AlgorithmError, f"{place} round {outcome.rounds}"):
            setpoint, late = _in_time(outcome, controller, state, fleet.exchange.late, late=now > due + sample_time)
            _check_sound(setpoint, outcome, place)
        with blaming(PlantError, f"{place}: act"):
            plant.act(setpoint, now)  # 3 act
        recorder.step(StepRecord.of(step, sensed, state, setpoint, outcome, late=late))  # 5 log
        if outcome.all_settled or exchange.departed(Last.ARRIVED):
            reason = Last.ARRIVED
            break
        if lost := exchange.lost_neighbours(step, now, nanoseconds(silent.after)):
            holding = "; ".join(f"neighbour {j} is lost ({how})" for j, how in lost.items())
            if silent.then == "stop":
                raise NeighbourLost(f"{place}: {holding}")
    now = yield Wait((step + 1) * sample_time)
    with blaming(PlantError, f"agent {me.id}: finish"):
        state = plant.sense(now)
        plant.finish(now, reason.name.lower())
    recorder.end(reason.name.lower(), now, state, holding, exchange.counts)
    yield exchange.goodbye(step + 1, now, reason)
    return reason


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


def _start(me: Me, exchange: Exchange, timeout: int) -> Loop[int]:
    """Agree on the instant of the start: the latest that any agent proposes, known to all after diameter rounds."""
    now = yield Wait(0)
    outcome = yield from exchange.negotiate(_latest(me, now + START_LEAD), -1, now, until=now + timeout)
    if outcome.result is None:
        raise NotReady(f"agent {me.id}: the fleet did not agree on a start within {timeout * 1e-9:g} s")
    return (yield Start(outcome.result))


def _latest(me: Me, proposal: int) -> Dialogue[int | None]:
    """The largest proposal of the fleet; None if somebody was not heard."""
    for _ in range(me.neighbourhood.diameter):
        inbox = yield {"start": proposal}, float("inf")
        if inbox.missing:
            return None
        proposal = max(proposal, *(int(inbox[j]["start"]) for j in inbox))
    return proposal


def _in_time(
    outcome: Outcome[Decision], controller: Controller, state: State, rule: str, *, late: bool
) -> tuple[Setpoint, bool]:
    """The setpoint that flies, and whether the step overran."""
    setpoint = outcome.result.setpoint
    if setpoint is not None and not late:
        return setpoint, False
    planned = controller.next_of_plan() if rule == "previous_plan" else None
    return planned or Setpoint.hold(state), True


def _finite(state: State, place: str) -> State:
    if not np.isfinite(state.vector).all():
        raise NumericalError(f"{place}: the plant's state is not finite: {_show(state.vector)}")
    return state


def _check_sound(setpoint: Setpoint, outcome: Outcome[Decision], place: str) -> None:
    """Refuse a decision, or a setpoint made from it, that is not finite."""
    flown = setpoint.vector if setpoint.acceleration is not None else setpoint.position
    for what, vector in (("the algorithm's decision", outcome.result.value), ("the controller's setpoint", flown)):
        if not np.isfinite(vector).all():
            raise NumericalError(f"{place} round {outcome.rounds}: {what} is not finite: {_show(vector)}")


def _show(vector: Array) -> str:
    return np.array2string(vector, precision=4, threshold=12)
