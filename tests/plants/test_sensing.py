import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from dcf_zenoh.plant import Array
from plants.sensing import LIGHTHOUSE, Estimator, Sensor, gains

SLOT = 0.01  # s
PERFECT = Sensor(1e-9, 0.0, SLOT, SLOT, 0.0, 0.0, 0.0, 1e-9)


def errors(sensor: Sensor, *, steps: int = 20000, seed: int = 0) -> Array:
    """Estimate minus truth of a body that swings to and fro, shape (steps, 6)."""
    estimator = Estimator(sensor, np.zeros(3), np.array([1.0, 0.0, 0.0]), np.random.default_rng(seed))
    found = []
    for step in range(1, steps + 1):
        t = step * SLOT
        truth = np.array([np.sin(t), 0.0, 0.0]), np.array([np.cos(t), 0.0, 0.0])
        estimator.step(*truth, SLOT)
        found.append(estimator.estimate - np.concatenate(truth))
    return np.array(found)


def test_gains_are_those_of_the_stationary_kalman_filter() -> None:
    sensor = LIGHTHOUSE
    period = (sensor.shortest + sensor.longest) / 2
    A, G = np.array([[1, period], [0, 1]]), np.array([[period**2 / 2], [period]])
    C, R = np.array([[1.0, 0.0]]), np.array([[sensor.noise**2]])
    predicted = solve_discrete_are(A.T, C.T, G @ G.T * sensor.accelerometer**2, R)
    gain = predicted @ C.T @ np.linalg.inv(C @ predicted @ C.T + R)
    alpha, beta = gains(sensor)
    np.testing.assert_allclose([alpha, beta / period], gain[:, 0], rtol=1e-9)


def test_a_perfect_sensor_is_believed() -> None:
    assert abs(errors(PERFECT, steps=500)).max() < 1e-4  # the acceleration is a difference quotient


def test_the_bias_stays_and_is_seen_in_the_position_alone() -> None:
    found = errors(PERFECT._replace(bias=0.02), steps=500)
    np.testing.assert_allclose(found[:, :3], found[-1:, :3].repeat(500, axis=0), atol=1e-4)
    assert 0.001 < abs(found[-1, :3]).max() < 0.08
    np.testing.assert_allclose(found[:, 3:], 0, atol=1e-2)


def test_filtered_noise_is_below_that_of_a_measurement() -> None:
    found = errors(LIGHTHOUSE._replace(bias=0.0, dropouts=0.0, latency=0.0))
    assert found[:, :3].std() < LIGHTHOUSE.noise
    assert found[:, 3:].std() < 0.05


def test_latency_and_dropouts_cost_accuracy() -> None:
    calm = LIGHTHOUSE._replace(bias=0.0, dropouts=0.0)
    prompt, late, broken = (
        errors(sensor)[:, :3].std()
        for sensor in (calm._replace(latency=0.0), calm._replace(latency=0.05), calm._replace(dropouts=0.5))
    )
    assert prompt < late < 0.05
    assert prompt < broken < 0.1


@pytest.mark.parametrize("seed", [1, 2])
def test_the_same_seed_makes_the_same_errors(seed: int) -> None:
    np.testing.assert_array_equal(errors(LIGHTHOUSE, steps=300, seed=seed), errors(LIGHTHOUSE, steps=300, seed=seed))
