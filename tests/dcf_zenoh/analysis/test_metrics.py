"""Single numbers of a flight, against motions that are known in closed form."""

from collections.abc import Sequence
from io import BytesIO

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.analysis.metrics import intrusions, overshoot, tracking_error
from dcf_zenoh.config import load
from dcf_zenoh.plant import Array, Setpoint, State, read_only
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import Recorder, StepRecord
from dcf_zenoh.records.run import Run

STEP = 200_000_000  # ns
ZERO = np.zeros(2)
DELAYED = ["controller.kind=receding_horizon", "controller.predict_delay=0.15"]


def logged(agent: int, states: Sequence[State], setpoints: Sequence[Setpoint], *, late: int = 0) -> AgentLog:
    """The log of an agent that had these states at its samples, and one more at the end if there is one."""
    stream = BytesIO()
    recorder = Recorder(stream, agent, {})
    for step, (state, setpoint) in enumerate(zip(states, setpoints, strict=False)):
        recorder.step(StepRecord.abstained(step, step * STEP + late, state, setpoint, ""))
    for state in states[len(setpoints) :]:
        recorder.end("done", len(setpoints) * STEP + late, state)
    return AgentLog.read(stream.getvalue(), "test")


def moving(position: Array, velocity: Array) -> State:
    return State(read_only(position), read_only(velocity))


def run_of(*logs: AgentLog, changes: Sequence[str] = ()) -> Run:
    return Run("test", load("position_swap", changes=changes).spec, {log.agent: log for log in logs})


def along(*places: tuple[float, float]) -> AgentLog:
    """Agent 1, which is to fly from (0, 1) to (0, -1), at these places."""
    states = [moving(np.array(place), ZERO) for place in places]
    return logged(1, states, [Setpoint.hold(state) for state in states])


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        ([(0.0, 1.0), (0.0, -0.9)], 0.0),
        ([(0.0, 1.0), (0.0, -1.25), (0.0, -1.1)], 0.25),
        ([(0.0, 1.0), (3.0, -1.125)], 0.125),  # the detour to the side is none of it
    ],
)
def test_overshoot_is_what_lies_beyond_the_target_on_the_line_from_the_start(
    places: list[tuple[float, float]], expected: float
) -> None:
    assert overshoot(run_of(along(*places))) == expected


def test_overshoot_is_that_of_the_worst_agent_and_counts_the_end() -> None:
    states = [moving(np.array([x, 0.0]), ZERO) for x in (1.0, -1.0, -1.5)]  # agent 3 is bound for (-1, 0)
    other = logged(3, states, [Setpoint.hold(states[0])] * 2)
    assert overshoot(run_of(along((0.0, 1.0), (0.0, -1.25)), other)) == 0.5


def test_a_fleet_without_bodies_has_no_such_numbers() -> None:
    run = dcf_zenoh.simulate("average")
    assert (overshoot(run), intrusions(run), tracking_error(run)) == (None, None, None)


def test_every_sample_in_a_safety_region_counts_as_one_sample_time() -> None:
    apart = [1.0, 0.2, 0.1, 1.0, 0.3, 1.0, 0.24]  # along y, where the region reaches 0.25 m
    places = [moving(np.array([0.0, y]), ZERO) for y in apart]
    rest = [moving(ZERO, ZERO)] * len(apart)
    far = [moving(np.array([0.0, -5.0]), ZERO)] * len(apart)
    logs = [
        logged(i, states, [Setpoint.hold(states[0])] * len(apart)) for i, states in enumerate((places, rest, far), 1)
    ]
    found = intrusions(run_of(*logs))
    assert found is not None
    assert found.number == 2  # steps 1 and 2 together; step 4 has h = 0.2; step 6
    assert found.time == pytest.approx(0.6)


def test_a_body_that_does_as_planned_has_no_tracking_error() -> None:
    assert tracking_error(dcf_zenoh.simulate("position_swap", changes=["time.duration=2.0"])) == pytest.approx(
        0, abs=1e-12
    )


def accelerated(steps: int, acceleration: Array) -> list[State]:
    """A body under constant acceleration, from rest, at the samples."""
    times = 0.2 * np.arange(steps)
    return [moving(acceleration * t**2 / 2, acceleration * t) for t in times]


@pytest.mark.parametrize("late", [0, 7_000_000])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_tracking_error_is_the_rms_distance_from_the_plan_one_sample_later(dimensions: int, late: int) -> None:
    acceleration = np.array([0.5, -1.0, 0.25])[:dimensions]
    states = accelerated(6, acceleration)
    if late:  # measured late, as on the wall clock, and said so
        times = 0.2 * np.arange(6) + late * 1e-9
        states = [moving(acceleration * t**2 / 2, acceleration * t) for t in times]
    off = [0.1, -0.2, 0.0, 0.3, 0.05]
    plans = [acceleration[:2] * (0.2 * (k + 1)) ** 2 / 2 + np.array([0.0, off[k]]) for k in range(5)]
    setpoints = [Setpoint(read_only(plan), read_only(ZERO), read_only(ZERO)) for plan in plans]
    found = tracking_error(run_of(logged(1, states, setpoints, late=late)))
    assert found == pytest.approx(np.sqrt(np.mean(np.square(off))), abs=1e-9)


def test_a_plan_for_later_is_compared_with_where_the_body_is_then() -> None:
    acceleration = np.array([0.5, -1.0])
    states = accelerated(6, acceleration)
    plans = [acceleration * (0.15 + 0.2 * (k + 1)) ** 2 / 2 + np.array([0.03, 0.04]) for k in range(6)]
    setpoints = [Setpoint(read_only(plan), read_only(ZERO), read_only(ZERO)) for plan in plans]
    run = run_of(logged(1, states, setpoints), changes=DELAYED)
    assert tracking_error(run) == pytest.approx(0.05, abs=1e-9)


def test_holding_is_no_plan() -> None:
    states = accelerated(4, np.array([1.0, 0.0]))
    assert tracking_error(run_of(logged(1, states, [Setpoint.hold(state) for state in states]))) is None


def test_a_gap_in_a_log_is_not_bridged() -> None:
    still = moving(ZERO, ZERO)
    plan = Setpoint(read_only([1.0, 0.0]), read_only(ZERO), read_only(ZERO))
    stream = BytesIO()
    for life in (((0, still), (1, still)), ((10, moving(np.array([9.0, 0.0]), ZERO)), (11, still))):
        recorder = Recorder(stream, 1, {})
        for step, state in life:
            recorder.step(StepRecord.abstained(step, step * STEP, state, plan, ""))
    assert tracking_error(run_of(AgentLog.read(stream.getvalue(), "test"))) == 1.0  # of steps 0 and 10 alone
