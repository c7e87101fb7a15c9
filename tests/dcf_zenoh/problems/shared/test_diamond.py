"""Diamond-shaped regions."""

import numpy as np

from dcf_zenoh.problems.shared.diamond import Obstacle, barrier, outline

RADII = (0.5, 0.25)


def test_corners_of_the_diamond_satisfy_its_equation() -> None:
    centre = np.array([0.3, -0.2])
    apart = abs(outline(centre, RADII) - centre)
    np.testing.assert_allclose(apart[:, 0] / 0.5 + apart[:, 1] / 0.25, 1.0, rtol=1e-14)


def test_barrier_of_many_points_is_that_of_each() -> None:
    apart = np.random.default_rng(1).normal(size=(5, 3, 2))
    each = [[abs(x) / 0.5 + abs(y) / 0.25 - 1 for x, y in row] for row in apart]
    np.testing.assert_allclose(barrier(apart, RADII), each, rtol=1e-14)


def test_an_obstacle_has_no_height() -> None:
    obstacle = Obstacle.of([1.0, 2.0, 0.5, 0.25])
    np.testing.assert_allclose(obstacle.barrier(np.array([[1.0, 2.0, 7.0], [1.5, 2.25, -7.0]])), [-1.0, 1.0])
