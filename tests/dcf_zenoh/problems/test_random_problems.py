"""Random problems of all kinds and units against an independent solver: no wrong status, no wrong answer."""

import clarabel
import numpy as np
import pytest
from scipy import sparse

from dcf_zenoh.algorithms.shared.local_qp import LocalQP
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.absolute_value import AbsoluteValue
from dcf_zenoh.problems.central import VariationalInequality, solve_together
from dcf_zenoh.problems.interior_point import OptimalityConditions, solve
from dcf_zenoh.problems.quadratic import Quadratic
from dcf_zenoh.problems.resource_allocation import ResourceAllocation

NAMES = {"Solved": "solved", "AlmostSolved": "solved", "PrimalInfeasible": "infeasible", "DualInfeasible": "unbounded",
         "AlmostPrimalInfeasible": "infeasible", "AlmostDualInfeasible": "unbounded"}  # fmt: skip
KINDS = ("solvable", "degenerate", "infeasible", "any")
UNITS = (1e-12, 1e-6, 1.0, 1e6, 1e12)


def draw(rng: np.random.Generator, kind: str) -> OptimalityConditions:
    """A problem with a solution, with dependent rows, with rows that contradict each other, or with any cost."""
    n, rows = int(rng.integers(1, 12)), int(rng.integers(2, 16))
    equations = int(rng.integers(0, min(n, rows - 1) + 1)) if rng.random() < 0.5 else 0
    root = rng.normal(size=(n, int(rng.integers(0, n + 1))))
    A = rng.normal(size=(rows, n)) * (rng.random((rows, n)) < rng.choice([0.3, 1.0]))
    x = rng.normal(size=n)
    slack = abs(rng.normal(size=rows)) * (rng.random(rows) < 0.5)
    slack[:equations] = 0.0
    if kind == "degenerate":
        A[-1], slack[-1] = A[equations], slack[equations]
    b = A @ x + slack
    y = abs(rng.normal(size=rows)) * (slack == 0) * (rng.random(rows) < 0.7)
    q = rng.normal(size=n) if kind == "any" else -root @ (root.T @ x) - A.T @ y
    if kind == "infeasible":
        A[-1], b[-1] = -A[0], -b[0] - abs(rng.normal()) - 0.1
    return OptimalityConditions(root @ root.T, q, A, b, equations)


def in_other_units(given: OptimalityConditions, rng: np.random.Generator) -> tuple[OptimalityConditions, float]:
    cost, length = 10.0 ** rng.uniform(-12, 12, 2)
    row = 10.0 ** rng.uniform(-6, 6, len(given.b))
    M, q, A, b, equations = given
    scaled = OptimalityConditions(
        M * cost / length**2, q * cost / length, A * row[:, None] / length, b * row, equations
    )
    return scaled, float(length)


def by_clarabel(given: OptimalityConditions) -> tuple[str, float]:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.ZeroConeT(given.equations), clarabel.NonnegativeConeT(len(given.b) - given.equations)]
    P, A = sparse.csc_matrix(np.triu(given.M)), sparse.csc_matrix(given.A)
    found = clarabel.DefaultSolver(P, given.q, A, given.b, cones, settings).solve()
    return NAMES.get(str(found.status), str(found.status)), float(found.obj_val)


def judge(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    given = draw(rng, kind)
    scaled, length = in_other_units(given, rng)
    expected, least = by_clarabel(given)
    for problem, unit in ((given, 1.0), (scaled, length)):
        found = solve(problem)
        if kind == "infeasible":
            assert found.status in ("infeasible", "unbounded"), seed  # it may be both
        elif kind != "any":
            assert found.status in ("solved", "inaccurate"), seed
        elif expected in NAMES.values():
            assert found.status.replace("inaccurate", "solved") == expected, seed
        if expected == "solved" and found.status in ("solved", "inaccurate"):
            x = found.x / unit
            assert x @ given.M @ x / 2 + given.q @ x == pytest.approx(least, abs=1e-6 * (1 + abs(least))), seed


@pytest.mark.parametrize("first", range(0, 200, 50))
def test_random_problems_have_the_independent_solver_s_status_and_cost(first: int) -> None:
    for seed in range(first, first + 50):
        judge(seed)


@pytest.mark.large
@pytest.mark.parametrize("first", range(1000, 3000, 200))
def test_two_thousand_random_problems(first: int) -> None:
    for seed in range(first, first + 200):
        judge(seed)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("cost", UNITS)
def test_weighted_medians_are_right_in_any_unit(cost: float, unit: float) -> None:
    rng = np.random.default_rng(7)
    for count in (3, 5, 8):
        values, weights = rng.normal(size=count), rng.uniform(0.5, 2.0, count)
        shares = {i: AbsoluteValue(value=unit * v, weight=cost * w).share()
                  for i, (v, w) in enumerate(zip(values, weights, strict=True))}  # fmt: skip
        order = np.argsort(values)
        median = values[order][np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)]
        assert solve_together(shares)[0][0] == pytest.approx(unit * median, rel=1e-7)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("cost", UNITS)
def test_allocations_and_means_are_right_in_any_unit(cost: float, unit: float) -> None:
    agents = (1, 2, 3, 4)
    limits = zip(agents, (1.0, 2.0, 4.0, 4.0), (4.0, 100.0, 100.0, 100.0), strict=True)
    shares = {i: ResourceAllocation(agents, demand=10 * unit, weight=cost * weight, upper=most * unit).share()
              for i, weight, most in limits}  # fmt: skip
    found = solve_together(shares)
    np.testing.assert_allclose([found[i][0] / unit for i in agents], [4.0, 3.0, 1.5, 1.5], rtol=1e-7)
    means = {i: Quadratic(centre=unit * i, weight=cost).share() for i in agents}
    assert solve_together(means)[1][0] == pytest.approx(2.5 * unit, rel=1e-9)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("cost", UNITS)
def test_local_programs_are_right_in_any_unit(cost: float, unit: float) -> None:
    rng = np.random.default_rng(3)
    root, r = rng.normal(size=(4, 4)), rng.normal(size=4)
    G, ends = np.vstack((np.eye(4), np.ones(4))), np.full(5, 0.3)

    def solved(c: float, u: float) -> Array:
        M = (root @ root.T + np.eye(4)) * c / u**2
        whole = VariationalInequality(M, r * c / u, G, -ends * u, ends * u, [])
        return LocalQP(whole, c / u**2).solve(np.ones(4) * c / u).v / u

    np.testing.assert_allclose(solved(cost, unit), solved(1.0, 1.0), atol=1e-6)


def test_a_cost_that_is_not_convex_is_named() -> None:
    shares = {i: Quadratic(centre=1.0).share() for i in (1, 2)}
    concave = {i: type(share)(-share.H, share.g, share.lower, share.upper, common=True) for i, share in shares.items()}
    with pytest.raises(AlgorithmError, match=r"there is no solution in one place: its cost is not convex"):
        solve_together(concave)
