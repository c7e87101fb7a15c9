import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from dcf_zenoh.problems.shared.riccati import solve_riccati


@pytest.mark.parametrize("seed", range(20))
def test_the_solution_is_that_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    root, effort = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    Q, R = root @ root.T, effort @ effort.T + 0.1 * np.eye(m)
    P = solve_riccati(A, B, Q, R)
    np.testing.assert_allclose(P, solve_discrete_are(A, B, Q, R), rtol=1e-7, atol=1e-9 * abs(P).max())
    np.testing.assert_array_equal(P, P.T)


def test_what_costs_nothing_adds_nothing() -> None:
    A, B = np.array([[1.0, 0.2], [0.0, 1.0]]), np.array([[0.02], [0.2]])
    velocity_alone = solve_riccati(A, B, np.diag([0.0, 1.0]), np.eye(1))
    np.testing.assert_allclose(velocity_alone, solve_discrete_are(A, B, np.diag([0.0, 1.0]), np.eye(1)), atol=1e-12)
    np.testing.assert_array_equal(solve_riccati(A, B, np.zeros((2, 2)), np.eye(1)), 0.0)


def test_what_cannot_be_stabilised_is_refused() -> None:
    with pytest.raises(ValueError, match="no stabilising solution"):
        solve_riccati(np.diag([2.0, 0.5]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1))
