import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.plant import Setpoint, State, read_only
from dcf_zenoh.testing import check_plant
from plants.single_integrator import SingleIntegrator

S = 1_000_000_000  # ns


def move(*v: float) -> Setpoint:
    return Setpoint(np.full(len(v), np.nan), np.array(v), np.zeros(len(v)))


def test_it_keeps_the_contract_of_plants() -> None:
    check_plant(lambda: SingleIntegrator(np.array([1.0, 2.0])))
    check_plant(lambda: SingleIntegrator(np.zeros(3), speed_max=0.1))


def test_a_straight_line_is_integrated_exactly() -> None:
    body = SingleIntegrator(np.array([1.0, 2.0, 0.5]), speed_max=10.0)
    body.act(move(0.5, -2.0, 0.25), 0)
    state = body.sense(3 * S)
    np.testing.assert_allclose(state.position, [2.5, -4.0, 1.25])
    np.testing.assert_allclose(state.velocity, [0.5, -2.0, 0.25])


def test_a_late_setpoint_acts_late_and_one_that_comes_twice_asks_for_the_same() -> None:
    body = SingleIntegrator(np.zeros(1))
    for instant in (S, 2 * S, 3 * S):
        body.act(move(0.5), instant)
    np.testing.assert_allclose(body.sense(4 * S).position, [1.5])


def test_a_velocity_above_the_limit_keeps_its_direction() -> None:
    body = SingleIntegrator(np.zeros(2), speed_max=1.0)
    body.act(move(3.0, -4.0), 0)
    np.testing.assert_allclose(body.sense(2 * S).vector, [1.2, -1.6, 0.6, -0.8])


def test_holding_is_resting_at_once() -> None:
    body = SingleIntegrator(np.zeros(2))
    body.act(move(0.5, 0.5), 0)
    body.act(Setpoint.hold(body.sense(S)), S)
    np.testing.assert_array_equal(body.sense(5 * S).vector, [0.5, 0.5, 0.0, 0.0])


def test_it_goes_on_from_a_known_state_at_rest() -> None:
    body = SingleIntegrator(np.zeros(2))
    body.resume(State(read_only([3.0, 4.0]), read_only([1.0, 1.0])), 7 * S)
    np.testing.assert_array_equal(body.sense(8 * S).vector, [3.0, 4.0, 0.0, 0.0])
    body.act(move(0.5, 0.0), 9 * S)
    np.testing.assert_allclose(body.sense(11 * S).position, [4.0, 4.0])


def test_options_and_setpoints_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="speed_max must be positive, in m/s, not 0"):
        SingleIntegrator(np.zeros(2), speed_max=0.0)
    with pytest.raises(ValueError, match="a setpoint with 2 velocities for a body of 3"):
        SingleIntegrator(np.zeros(3)).act(move(1.0, 1.0), 0)


@pytest.mark.parametrize("lag", [None, 0.0])
def test_the_paper_swap_arrives_and_the_model_that_fits_predicts_every_step(lag: float | None) -> None:
    changes = [] if lag is None else [f"problem.prediction.velocity_lag={lag}"]
    run = dcf_zenoh.simulate("position_swap", plant="single_integrator", changes=changes)
    assert run.arrival_time is not None
    assert run.barriers.min() >= (0.05 if lag is None else 0.1)
    error = max(abs(log.setpoint[:-1, :2] - log.state[1:, :2]).max() for log in run.agents.values())
    assert bool(error < 1e-12) is (lag == 0.0)  # the planned position is where the body is one step later


def test_a_plan_for_a_later_moment_starts_from_the_velocity_that_is_being_flown() -> None:
    changes = [
        "problem.prediction.velocity_lag=0.0",
        "controller.kind=receding_horizon",
        "controller.predict_delay=0.1",
    ]
    run = dcf_zenoh.simulate("position_swap", plant="single_integrator", changes=[*changes, "time.duration=3.0"])
    for log in run.agents.values():
        velocity, acceleration = log.setpoint[:, 2:4], log.setpoint[:, 4:6]
        np.testing.assert_allclose(velocity[1:], velocity[:-1] + 0.2 * acceleration[1:], atol=1e-12)
        apart = log.state[2:, :2] - log.state[1:-1, :2]  # for half of each step the earlier velocity was flown
        np.testing.assert_allclose(apart, 0.1 * (velocity[:-2] + velocity[1:-1]), atol=1e-12)
