"""The decisions of a whole fleet, found in one place from the shares of all agents, by OSQP.

Source: Stellato, Banjac, Goulart, Bemporad, Boyd, "OSQP: an operator splitting solver for quadratic programs",
Mathematical Programming Computation, 2020.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import osqp
from scipy import sparse

from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.problems.share import Share

TOLERANCE = 1e-11  # tolerance of the solver, absolute and relative
SYMMETRIC = 1e-12  # relative asymmetry; a larger one makes no quadratic cost


def solve_together(shares: Mapping[int, Share]) -> dict[int, Array]:
    """Return the decisions of all agents: the minimiser of the sum of costs, or the variational equilibrium of a game.

    Args:
        shares: Agent -> share, of all agents of the fleet.

    Returns:
        Agent -> decision.

    Raises:
        AlgorithmError: There is no solution, or none was found; the message has the solver's status.
    """
    if any(share.t.size for share in shares.values()):
        raise AlgorithmError("there is no solution in one place: the shared constraints are not linear")
    whole = assemble([share for _, share in sorted(shares.items())])
    v = _minimiser(whole) if whole.symmetric else _equilibrium(whole)
    return {agent: read_only(v[places]) for agent, places in zip(sorted(shares), whole.places, strict=True)}


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
        scale = max(1.0, float(abs(self.M).max(initial=0.0)))
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


def _minimiser(whole: VariationalInequality) -> Array:
    """Return the solution where M is symmetric: the minimiser of v'M v / 2 + r'v."""
    return _osqp(whole.M, whole.r, whole.G, whole.low, whole.high)


def _equilibrium(whole: VariationalInequality) -> Array:
    """Return the solution of a monotone variational inequality, as that of a convex quadratic program.

    Its conditions are M v + r + A'y = 0, A v <= b, y >= 0 (free for equations) and y'(b - A v) = 0. Under the first
    three, y'(b - A v) = v'M v + r'v + b'y >= 0, so its least value is 0, and there the fourth holds too. It is convex
    in (v, y) where M + M' is positive semidefinite.

    Source: Harker and Pang, "Finite-dimensional variational inequality and nonlinear complementarity problems",
    Mathematical Programming, 1990, Section 3.
    """
    equations = whole.low == whole.high
    above, below = np.isfinite(whole.high) & ~equations, np.isfinite(whole.low) & ~equations
    A = np.vstack((whole.G[equations], whole.G[above], -whole.G[below]))
    b = np.concatenate((whole.high[equations], whole.high[above], -whole.low[below]))
    free = int(equations.sum())
    n, m = len(whole.r), len(b)
    P = np.zeros((n + m, n + m))
    P[:n, :n] = whole.M + whole.M.T
    G = np.block([[whole.M, A.T], [A, np.zeros((m, m))], [np.zeros((m, n)), np.eye(m)]])
    least_y = np.where(np.arange(m) < free, -np.inf, 0.0)
    low = np.concatenate((-whole.r, np.where(np.arange(m) < free, b, -np.inf), least_y))
    high = np.concatenate((-whole.r, b, np.full(m, np.inf)))
    return _osqp(P, np.concatenate((whole.r, b)), G, low, high)[:n]


def _osqp(P: Array, q: Array, G: Array, low: Array, high: Array) -> Array:
    """Return the z with the least z'P z / 2 + q'z under low <= G z <= high."""
    solver = osqp.OSQP()
    solver.setup(
        sparse.csc_matrix(np.triu(P)), q, sparse.csc_matrix(G), low, high,
        verbose=False, eps_abs=TOLERANCE, eps_rel=TOLERANCE, max_iter=200_000,
        adaptive_rho_interval=50,  # in iterations, not in time: the same bits again
    )  # fmt: skip
    found = solver.solve(raise_error=False)
    if found.info.status != "solved":
        raise AlgorithmError(f"there is no solution: OSQP says {found.info.status}")
    return np.asarray(found.x, dtype=np.float64)
