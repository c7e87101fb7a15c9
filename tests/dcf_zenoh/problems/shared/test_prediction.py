import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_discrete_are

from dcf_zenoh.plant import Array, Setpoint, State
from dcf_zenoh.problems.shared.prediction import Prediction, state_ahead
from dcf_zenoh.problems.shared.swap_options import CostOptions, PredictionOptions

T, H = 0.2, 4


def prediction(lag: float | None) -> Prediction:
    cost = CostOptions(state=(5.0, 4.0, 3.0, 2.0), input=(2.0, 1.0), terminal=1.5)
    return Prediction.of(T, PredictionOptions(H, velocity_lag=lag), cost)


def flown(state: Array, inputs: Array, lag: float | None) -> list[Array]:
    """States at the sampling instants, by numerical integration of the body."""
    path = [state]
    for a in inputs:
        told = path[-1][2:] + a * T  # the velocity that the body is told in this step

        def move(_t: float, z: Array, a: Array = a, told: Array = told) -> Array:
            return np.concatenate((z[2:], a if lag is None else (told - z[2:]) / lag))

        path.append(solve_ivp(move, (0, T), path[-1], rtol=1e-11, atol=1e-13).y[:, -1])
    return path


@pytest.mark.parametrize("lag", [None, 0.05, 0.3])
def test_the_prediction_is_what_an_integrated_body_does(lag: float | None) -> None:
    rng, model = np.random.default_rng(0), prediction(lag)
    for _ in range(5):
        state, inputs = rng.normal(size=4), rng.normal(size=(H, 2))
        for step, reached in enumerate(flown(state, inputs, lag)):
            predicted = model.powers[step] @ state + model.lifts[step] @ inputs.ravel()
            np.testing.assert_allclose(predicted, reached, atol=1e-9)


def test_without_lag_the_velocity_is_there_at_once() -> None:
    model, lagging = prediction(0.0), prediction(1e-4)
    step = model.lifts[1][:, 0]
    np.testing.assert_allclose(step, [T**2, 0, T, 0])
    np.testing.assert_allclose(lagging.lifts[1][:, 0], step, atol=3e-5)


@pytest.mark.parametrize("lag", [None, 0.0, 0.3])
def test_the_quadratic_form_is_the_cost_of_the_predicted_motion(lag: float | None) -> None:
    rng, model = np.random.default_rng(1), prediction(lag)
    Q, R = np.diag([5.0, 4.0, 3.0, 2.0]), np.diag([2.0, 1.0])
    A, B = model.powers[1], model.lifts[1][:, :2]
    P = 1.5 * solve_discrete_are(A, B, Q, R)

    def cost(state: Array, inputs: Array) -> float:
        total = 0.0
        for u in inputs:
            total += state @ Q @ state + u @ R @ u
            state = A @ state + B @ u
        return float(total + state @ P @ state)

    for _ in range(5):
        state, inputs = rng.normal(size=4), rng.normal(size=(H, 2))
        u = inputs.ravel()
        difference = cost(state, inputs) - cost(state, 0 * inputs)
        np.testing.assert_allclose(u @ model.quadratic @ u + 2 * (model.linear @ state) @ u, difference, rtol=1e-9)


@pytest.mark.parametrize("lag", [None, 0.05, 0.3])
def test_the_state_after_a_delay_is_what_an_integrated_body_has(lag: float | None) -> None:
    state, a = np.array([1.0, -2.0, 0.4, -0.6]), np.array([0.7, 1.2])
    told = np.array([-0.3, 0.9])

    def move(_t: float, z: Array) -> Array:
        return np.concatenate((z[2:], a if lag is None else (told - z[2:]) / lag))

    reached = solve_ivp(move, (0, 0.15), state, rtol=1e-11, atol=1e-13).y[:, -1]
    sensed = State(state[:2], state[2:])
    np.testing.assert_allclose(state_ahead(sensed, Setpoint(velocity=told, acceleration=a), 0.15, lag), reached)


def test_the_state_after_a_delay_knows_rest_and_bodies_that_obey_at_once() -> None:
    body = State(np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.0, 0.1]))
    planar = Setpoint(np.zeros(2), np.array([0.1, -0.2]), np.zeros(2))
    np.testing.assert_allclose(state_ahead(body, planar, 0.5, 0.0), [1.05, 1.9, 3.0, 0.1, -0.2, 0.0])
    np.testing.assert_allclose(state_ahead(body, Setpoint.hold(body), 0.5, 0.0), [1, 2, 3, 0, 0, 0])
    for lag in (None, 0.0, 0.1):  # nothing is being flown
        np.testing.assert_allclose(state_ahead(body, None, 0.5, lag), [1.25, 2.0, 3.05, 0.5, 0.0, 0.1])


def test_a_negative_lag_is_refused() -> None:
    with pytest.raises(ValueError, match=r"velocity_lag must be a time >= 0, in s, not -0\.1"):
        prediction(-0.1)
