"""The paper's example with nonlinear Crazyflies."""

import numpy as np

from dcf_zenoh.plant import Array
from dcf_zenoh.run import Run
from dcf_zenoh.simulation import simulate

START = np.array([[0.0, 1.0], [0.0, -1.0], [1.0, 0.0], [-1.0, 0.0]])  # the targets are opposite


def overshoot(run: Run) -> Array:
    """How far each agent went beyond its target, along the line from its start, m."""
    away = run.positions[:, :, :2] + START
    along = np.sum(away * -START, axis=2)  # START has unit length
    return np.asarray(along.max(axis=0))


def test_position_swap_arrives_with_a_little_overshoot_and_without_a_collision() -> None:
    run = simulate("position_swap", plant="twin")
    assert run.arrival_time is not None
    assert 10 <= run.arrival_time <= 14
    assert run.distances.min() >= 0.2
    assert run.barriers.min() > 0.05
    assert 0.04 < overshoot(run).max() < 0.2
    np.testing.assert_allclose(run.positions[0, :, :2], START, atol=0.01)
    np.testing.assert_allclose(run.positions[:, :, 2], 1.0, atol=0.03)


def test_noise_and_wind_repeat_with_the_seed_of_the_fleet() -> None:
    changes = ['plants.twin.sensing="lighthouse"', "plants.twin.gusts=0.2", "time.duration=3.0"]
    first, again = (simulate("position_swap", plant="twin", changes=changes) for _ in range(2))
    other = simulate("position_swap", plant="twin", changes=changes, seed=2)
    assert first.digest == again.digest
    assert first.digest != other.digest
