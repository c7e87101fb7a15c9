"""The local quadratic program: right, warm, repeatable, and clear where it has no solution."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from dcf_zenoh.algorithms.shared.local_qp import LocalQP, Solution
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.central import VariationalInequality

N = 12


def boxed(seed: int, low: float = -0.5, high: float = 0.5) -> VariationalInequality:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(N, N))
    return VariationalInequality(
        root @ root.T + np.eye(N), rng.normal(scale=3, size=N), np.eye(N), np.full(N, low), np.full(N, high), []
    )


def by_least_squares(whole: VariationalInequality, weight: float, pull: Array) -> Array:
    """The same by an active-set method: with L L' = M + weight I, least |L'v - L^-1 (pull - r)|."""
    L = np.linalg.cholesky(whole.M + weight * np.eye(N))
    found = lsq_linear(L.T, np.linalg.solve(L, pull - whole.r), (whole.low, whole.high), method="bvls", tol=1e-14)
    return np.asarray(found.x)


@pytest.mark.parametrize("seed", range(4))
def test_it_finds_the_least_cost_within_the_limits_for_one_pull_after_another(seed: int) -> None:
    whole, rng = boxed(seed), np.random.default_rng(seed)
    problem = LocalQP(whole, 2.0)
    for _ in range(5):
        pull = rng.normal(scale=5, size=N)
        found = problem.solve(pull)
        np.testing.assert_allclose(found.v, by_least_squares(whole, 2.0, pull), atol=1e-7)
        slope = (whole.M + 2 * np.eye(N)) @ found.v + whole.r - pull
        np.testing.assert_allclose(slope, -found.prices, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_it_starts_where_it_ended_and_where_it_is_told_to(seed: int) -> None:
    whole, pull = boxed(seed), np.random.default_rng(seed).normal(scale=5, size=N)
    cold = LocalQP(whole, 2.0)
    solution = cold.solve(pull)
    needed = cold.iterations
    cold.solve(pull)
    assert cold.iterations == 5  # the first at which it looks
    warm = LocalQP(whole, 2.0, solution)
    np.testing.assert_allclose(warm.solve(pull).v, solution.v, atol=1e-8)
    assert warm.iterations == 5
    assert needed >= 15
    near = LocalQP(whole, 2.0, solution)
    near.solve(pull + 1e-3)
    assert near.iterations <= needed


def test_a_start_of_another_shape_is_ignored() -> None:
    whole, pull = boxed(1), np.ones(N)
    expected = LocalQP(whole, 2.0).solve(pull)
    other = LocalQP(whole, 2.0, Solution(np.ones(3), np.ones(3)))
    np.testing.assert_array_equal(other.solve(pull).v, expected.v)


def test_the_same_calls_give_the_same_bits() -> None:
    pulls = np.random.default_rng(5).normal(scale=4, size=(200, N))
    first, second = (LocalQP(boxed(2), 2.0) for _ in range(2))
    for pull in pulls:
        one, other = first.solve(pull), second.solve(pull)
        assert one.v.tobytes() == other.v.tobytes()
        assert one.prices.tobytes() == other.prices.tobytes()


def test_what_it_found_cannot_be_changed() -> None:
    found = LocalQP(boxed(0), 2.0).solve(np.zeros(N))
    before = found.v.copy()
    with pytest.raises(ValueError, match="read-only"):
        found.v[0] = 1.0
    assert found.v.tobytes() == before.tobytes()


def test_no_solution_is_said_with_the_solver_s_status() -> None:
    whole = boxed(0)._replace(G=np.vstack((np.eye(N), np.ones(N))), low=np.full(N + 1, 1.0), high=np.full(N + 1, 2.0))
    with pytest.raises(
        AlgorithmError,
        match=r"^the local problem has no solution: the problem is infeasible: its constraints contradict each other$",
    ):
        LocalQP(whole, 2.0).solve(np.zeros(N))
    falling = boxed(0)._replace(M=np.zeros((N, N)), low=np.full(N, -np.inf))
    with pytest.raises(
        AlgorithmError,
        match=r"^the local problem has no solution: the problem is unbounded: its cost has no least value$",
    ):
        LocalQP(falling, 0.0).solve(np.full(N, -10.0))


def test_what_cannot_be_kept_is_missed_by_as_little_as_can_be() -> None:
    """Components of at most 1/2 cannot sum to 8 or more: all go to their bounds; the price does not matter."""
    low, high = np.append(np.full(N, -0.5), -np.inf), np.append(np.full(N, 0.5), -8.0)
    whole = boxed(0)._replace(G=np.vstack((np.eye(N), -np.ones(N))), low=low, high=high)
    soft = LocalQP(whole, 2.0, slack_price=1e3)
    for pull in np.random.default_rng(1).normal(size=(3, N)):
        found = soft.solve(pull)
        np.testing.assert_allclose(found.v, 0.5, atol=1e-6)
        assert found.prices[-1] == pytest.approx(1e3)
    assert soft.softened


def test_slack_changes_nothing_where_there_is_a_solution() -> None:
    pull = np.random.default_rng(3).normal(scale=5, size=N)
    hard, soft = LocalQP(boxed(3), 2.0), LocalQP(boxed(3), 2.0, slack_price=1e3)
    assert hard.solve(pull).v.tobytes() == soft.solve(pull).v.tobytes()
    assert not soft.softened
