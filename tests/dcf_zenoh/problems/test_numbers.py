"""What built-in problems compute, by hand; and what numbers they refuse."""

from collections.abc import Callable

import numpy as np
import pytest

from dcf_zenoh.problems.absolute_value import AbsoluteValue
from dcf_zenoh.problems.cournot import Cournot
from dcf_zenoh.problems.lasso import Lasso
from dcf_zenoh.problems.quadratic import Quadratic
from dcf_zenoh.problems.quadratic_game import QuadraticGame
from dcf_zenoh.problems.resource_allocation import ResourceAllocation


def test_a_square_and_a_slope_meet_where_they_cancel() -> None:
    problem = Quadratic(centre=[1.0, -2.0], weight=[2.0, 4.0], lower=-1.0)
    np.testing.assert_allclose(problem.gradient(np.zeros(2)), [-2.0, 8.0])
    assert problem.cost(np.zeros(2)) == pytest.approx(1.0 + 8.0)
    np.testing.assert_allclose(problem.argmin(np.array([1.0, 0.0]), 1.0), [1 / 3, -1.0])  # (2 - 1) / 3; bound


def test_the_soft_threshold_stays_at_the_kink_while_the_pull_is_weak() -> None:
    problem = AbsoluteValue(value=3.0, weight=2.0)
    for slope, x in ((-6.0, 3.0), (-4.0, 2.0), (0.0, 0.0)):
        # |x - 3| * 2 + slope x + x² / 2: at the kink while |slope + 3| <= 2
        expected = 3.0 if abs(slope + 3.0) <= 2.0 else 3.0 - np.sign(slope + 3.0) * (abs(slope + 3.0) - 2.0)
        np.testing.assert_allclose(problem.argmin(np.array([slope]), 1.0), [expected])
        grid = np.linspace(-10, 10, 200_001)
        best = grid[np.argmin(2.0 * abs(grid - 3.0) + slope * grid + grid**2 / 2)]
        assert best == pytest.approx(expected, abs=1e-4), x


def test_a_seed_gives_the_same_data_and_every_agent_its_own() -> None:
    one, same, other, elsewhere = (Lasso(i, (1, 2), seed=seed) for i, seed in ((1, 5), (1, 5), (2, 5), (1, 6)))
    assert np.array_equal(one.A, same.A)
    assert np.array_equal(one.b, same.b)
    assert not np.array_equal(one.A, other.A)
    assert not np.array_equal(one.A, elsewhere.A)


def test_the_lasso_of_one_agent_satisfies_its_optimality_conditions() -> None:
    problem = Lasso(1, (1, 2), size=6, rows=4, l1=3.0, seed=2)
    slope, weight = np.linspace(-1, 1, 6), 0.7
    x = problem.argmin(slope, weight)
    rest = problem.A.T @ (problem.A @ x - problem.b) + slope + weight * x
    used = x != 0
    assert used.any()
    assert not used.all()
    np.testing.assert_allclose(rest[used], -1.5 * np.sign(x[used]), atol=1e-12)
    assert (abs(rest[~used]) <= 1.5 + 1e-12).all()


def test_a_firm_sees_the_price_fall_with_what_it_makes_itself() -> None:
    firm = Cournot(2, (1, 2, 3), cost=1.0, price=10.0, slope=0.5)
    profile = np.array([[1.0], [2.0], [3.0]])

    def cost(x: float) -> float:
        return 1.0 * x - x * (10.0 - 0.5 * (1.0 + x + 3.0))

    rise = (cost(2.0 + 1e-6) - cost(2.0 - 1e-6)) / 2e-6
    np.testing.assert_allclose(firm.pseudo_gradient(profile), [rise], atol=1e-8)
    np.testing.assert_allclose(firm.gradient(profile[1], profile.mean(axis=0)), [rise], atol=1e-8)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Quadratic(centre=0.0, weight=0.0), "weight must be positive, not 0.0"),
        (lambda: Quadratic(centre=[0.0, 1.0], weight=[1.0, 2.0, 3.0]), "weight must be a number or a list of 2"),
        (lambda: Quadratic(centre=0.0, lower=1.0, upper=0.5), "lower must not be above upper, and 1.0 is above 0.5"),
        (lambda: AbsoluteValue(value=0.0, weight=-1.0), "weight must be positive, not -1.0"),
        (lambda: Lasso(1, (1,), nonzero=9), "nonzero must be from 0 to size, which is 8, not 9"),
        (lambda: Lasso(1, (1,), rows=0), "rows must be at least 1, not 0"),
        (lambda: Lasso(1, (1,), l1=-1.0), "l1 must not be negative, and is -1.0"),
        (lambda: ResourceAllocation((1, 2), demand=1.0, weight=0.0), "weight must be positive"),
        (lambda: Cournot(1, (1, 2), cost=1.0, slope=0.0), "slope must be positive, not 0.0"),
        (lambda: Cournot(1, (1, 2), cost=1.0, capacity=-1.0), "capacity must not be negative, and is -1.0"),
        (
            lambda: QuadraticGame(1, (1, 2), row=[1.0]),
            r"row must have one number for each of the 2 agents, not \[1.0\]",
        ),
        (lambda: QuadraticGame(1, (1, 2), row=[0.0, 1.0]), "row must be positive at the agent itself, and is 0 there"),
    ],
)
def test_numbers_out_of_range_are_refused(make: Callable[[], object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        make()
