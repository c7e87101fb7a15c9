"""The decisions of a whole fleet, found in one place from the shares of all agents; see `interior_point`."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.problems.interior_point import OptimalityConditions, Optimum, solve
from dcf_zenoh.problems.share import Share

SYMMETRIC = 1e-12  # relative asymmetry; a larger one makes no quadratic cost
CONVEX = 1e-9  # relative curvature below zero; more makes no convex cost
VIOLATION_PRICE = 1e4  # relative to the largest number of the costs
REASONS = {
    "infeasible": "the problem is infeasible: its constraints contradict each other",
    "unbounded": "the problem is unbounded: its cost has no least value",
}


class Together(NamedTuple):
    """Decisions of all agents and how exact they are.

    Attributes:
        decisions: Agent -> decision, read-only.
        residual: Largest relative residual of the optimality conditions.
        accurate: Whether the solver reached its tolerance, `interior_point.ACCURATE`.
        violated: Whether there is no solution, and the decisions violate shared constraints as little as possible.
    """

    decisions: dict[int, Array]
    residual: float
    accurate: bool
    violated: bool


def solve_together(shares: Mapping[int, Share]) -> dict[int, Array]:
    """Return the decisions of all agents: the minimiser of the sum of costs, or the variational equilibrium of a game.

    Args:
        shares: Agent -> share, of all agents of the fleet.

    Returns:
        Agent -> decision.

    Raises:
        AlgorithmError: There is no solution, or none was found; the message tells which.
    """
    return solve_with_residual(shares).decisions


def solve_with_residual(shares: Mapping[int, Share], *, tolerant: bool = False) -> Together:
    """Return the decisions of all agents and how exact they are; see `solve_together`.

    Where the problem is infeasible and `tolerant` is set, the inequalities are softened at a price far above its costs.
    """
    if any(share.t.size for share in shares.values()):
        raise AlgorithmError("there is no solution in one place: the shared constraints are not linear")
    whole = assemble([share for _, share in sorted(shares.items())])
    found = solution(whole)
    if violated := tolerant and found.status == "infeasible":
        largest = max(float(abs(whole.M).max(initial=0.0)), float(abs(whole.r).max(initial=0.0)))
        found = solution(softened(whole, VIOLATION_PRICE * largest))
    if found.status in REASONS:
        raise AlgorithmError(f"there is no solution: {REASONS[found.status]}")
    if found.status == "out of iterations":
        raise AlgorithmError(
            f"no solution was found: the solver is out of iterations at a relative residual of {found.residual:.1g}"
        )
    decisions = {agent: read_only(found.x[places]) for agent, places in zip(sorted(shares), whole.places, strict=True)}
    return Together(decisions, found.residual, found.status == "solved", violated)


class VariationalInequality(NamedTuple):
    """Find v with low <= G v <= high and (M v + r)'(w - v) >= 0 for all w with low <= G w <= high.

    Attributes:
        M: Shape (n, n).
        r: Shape (n,).
        G: Shape (rows, n).
        low: Shape (rows,); -inf where there is no bound.
        high: Shape (rows,); inf where there is no bound.
        places: Slices of v, one for the decision of each agent.
    """

    M: Array
    r: Array
    G: Array
    low: Array
    high: Array
    places: list[slice]

    @property
    def symmetric(self) -> bool:
        """Whether M is that of a quadratic cost, which all agents minimise together."""
        scale = float(abs(self.M).max(initial=0.0))
        return bool((abs(self.M - self.M.T) <= SYMMETRIC * scale).all())


def assemble(shares: list[Share]) -> VariationalInequality:
    """Return the problem of all agents; each kink adds t >= absolute |u - kink| to the variables and to the cost."""
    common, equality = (bool(np.any([getattr(each, name) for each in shares])) for name in ("common", "equality"))
    sizes = [len(each.g) for each in shares]
    ends = np.cumsum(sizes).tolist()
    places = [slice(0, sizes[0]) if common else slice(end - n, end) for end, n in zip(ends, sizes, strict=True)]
    decided = sizes[0] if common else ends[-1]
    kinks = [(place.start + k, each.absolute[k], each.kink[k]) for place, each in zip(places, shares, strict=True)
             for k in np.flatnonzero(each.absolute)]  # fmt: skip
    size = decided + len(kinks)

    M, r = np.zeros((size, size)), np.zeros(size)
    r[decided:] = 1.0
    for place, each in zip(places, shares, strict=True):
        M[place, place] += each.H
        r[place] += each.g
        for other, share in zip(places, shares, strict=True) if each.K.size else ():
            M[place, other] += each.K @ share.Phi / len(shares)
            r[place] += each.K @ share.phi / len(shares)

    rows: list[Array] = []
    low: list[float] = []
    high: list[float] = []

    def add(row: Array, least: float, most: float) -> None:
        rows.append(row)
        low.append(least)
        high.append(most)

    eye = np.eye(size)
    for place, each in zip(places, shares, strict=True):
        for k, (least, most) in enumerate(zip(each.lower, each.upper, strict=True)):
            if np.isfinite(least) or np.isfinite(most):
                add(eye[place.start + k], least, most)
    for extra, (entry, weight, kink) in enumerate(kinks):
        for sign in (1.0, -1.0):
            add(sign * weight * eye[entry] - eye[decided + extra], -np.inf, sign * weight * kink)
    for row in range(len(shares[0].b)):
        shared = np.zeros(size)
        for place, each in zip(places, shares, strict=True):
            shared[place] += each.A[row]
        total = float(np.sum([each.b[row] for each in shares]))
        add(shared, total if equality else -np.inf, total)
    return VariationalInequality(M, r, np.array(rows).reshape(-1, size), np.array(low), np.array(high), places)


def solution(whole: VariationalInequality) -> Optimum:
    """Return the solution, or the reason why there is none; multipliers are those of the rows of G.

    Raises:
        AlgorithmError: The cost is not convex, or the game not monotone; or a number is not finite.
    """
    curvature = (whole.M + whole.M.T) / 2
    largest = abs(curvature).max(axis=0, initial=0.0)
    unit = 1.0 / np.sqrt(np.where(largest > 0, largest, 1.0))
    scaled = unit[:, None] * curvature * unit
    if not (np.isfinite(scaled).all() and np.isfinite(whole.r).all() and np.isfinite(whole.G).all()):
        raise AlgorithmError("there is no solution in one place: the problem has numbers that are not finite")
    if scaled.size and float(np.linalg.eigvalsh(scaled)[0]) < -CONVEX * len(scaled):
        kind = "its cost is not convex" if whole.symmetric else "the game is not monotone"
        raise AlgorithmError(f"there is no solution in one place: {kind}")
    equations = whole.low == whole.high
    above, below = np.isfinite(whole.high) & ~equations, np.isfinite(whole.low) & ~equations
    A = np.vstack((whole.G[equations], whole.G[above], -whole.G[below]))
    b = np.concatenate((whole.high[equations], whole.high[above], -whole.low[below]))
    found = solve(OptimalityConditions(whole.M, whole.r, A, b, int(equations.sum())))
    y = np.zeros(len(whole.G))
    for rows, prices, sign in zip(
        (equations, above, below), np.split(found.y, np.cumsum((equations.sum(), above.sum()))), (1.0, 1.0, -1.0),
        strict=True,
    ):  # fmt: skip
        y[rows] += sign * prices
    return found._replace(y=y)


def softened(program: VariationalInequality, price: float) -> VariationalInequality:
    """Return the program with a slack s >= 0, at cost `price`, in each inequality of several components."""
    n, soft = len(program.r), np.flatnonzero((np.count_nonzero(program.G, axis=1) > 1) & np.isinf(program.low))
    slack = np.zeros((len(program.G), len(soft)))
    slack[soft, np.arange(len(soft))] = -1.0
    return program._replace(
        M=block_diag(program.M, np.zeros((len(soft), len(soft)))),
        r=np.concatenate((program.r, np.full(len(soft), price))),
        G=np.block([[program.G, slack], [np.zeros((len(soft), n)), np.eye(len(soft))]]),
        low=np.concatenate((program.low, np.zeros(len(soft)))),
        high=np.concatenate((program.high, np.full(len(soft), np.inf))),
    )
