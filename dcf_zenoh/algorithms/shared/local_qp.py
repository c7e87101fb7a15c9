"""Quadratic program that is solved repeatedly while its linear cost changes."""

from typing import NamedTuple

import numpy as np
import osqp
from scipy import sparse

from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.problems.central import REASONS, VariationalInequality, softened, solution

TOLERANCE = 1e-9  # of the solver, absolute and relative
USUAL = (2.0**-10, 2.0**30)  # sizes of costs and decisions for which an absolute tolerance is right
CHECK_EVERY = 5  # iterations; a warm start needs few


class Solution(NamedTuple):
    """Primal and dual solution of a quadratic program.

    Attributes:
        v: Minimiser, shape (n,), read-only.
        prices: Multipliers of the rows of G, shape (rows,), positive at an upper limit, read-only.
    """

    v: Array
    prices: Array


class LocalQP:
    """Minimises v'M v / 2 + r'v + weight / 2 |v|² - pull'v under low <= G v <= high, for one pull after another.

    OSQP is set up once and keeps its factorisation; each solve starts from the last solution. Its settings count
    iterations and never measure time, so the same calls give the same bits.

    Costs and decisions far from the size 1 are scaled by powers of two before. Where OSQP finds no solution, the
    interior-point method looks for one and tells why there is none.

    If the program is infeasible, its inequalities are softened for good: each that is not a bound on one component gets
    a slack with a linear cost.

    Args:
        whole: M, r, G, low and high.
        weight: Weight, not negative; positive if M is not positive definite.
        warm: Start of the first solve; None, or one of another shape: zero.
        slack_price: Cost per unit of slack; None: an infeasible program is an error.

    Attributes:
        iterations: Iterations of OSQP in the last solve.
        softened: Whether the inequalities were softened.

    Source: Stellato, Banjac, Goulart, Bemporad, Boyd, "OSQP: an operator splitting solver for quadratic programs",
    Mathematical Programming Computation, 2020.
    """

    def __init__(
        self,
        whole: VariationalInequality,
        weight: float,
        warm: Solution | None = None,
        slack_price: float | None = None,
    ) -> None:
        self._r, self._rows = whole.r, len(whole.G)
        self._program = whole._replace(M=whole.M + weight * np.eye(len(whole.r)))
        self._slack_price = slack_price
        self._cost, self._length = _units(self._program)
        self._solver = self._set_up()
        self.iterations, self.softened = 0, False
        if warm is not None and (len(warm.v), len(warm.prices)) == (len(whole.r), self._rows):
            self._solver.warm_start(x=warm.v / self._length, y=warm.prices * (self._cost * self._length))

    def solve(self, pull: Array) -> Solution:
        """Return the solution for this `pull`, shape (n,).

        Raises:
            AlgorithmError: There is none, or it was not found; the message tells which.
        """
        n, slope = len(self._r), self._cost * self._length
        r = np.concatenate((self._r - pull, self._program.r[n:]))
        self._solver.update(q=r * slope)
        found = self._solver.solve(raise_error=False)
        self.iterations = int(found.info.iter)
        if found.info.status == "solved":
            return Solution(read_only(found.x[:n] * self._length), read_only(found.y[: self._rows] / slope))
        exact = solution(self._program._replace(r=r))
        if exact.status in ("solved", "inaccurate"):
            self._solver.warm_start(x=exact.x / self._length, y=exact.y * slope)
            return Solution(read_only(exact.x[:n]), read_only(exact.y[: self._rows]))
        if exact.status == "infeasible" and self._slack_price is not None and not self.softened:
            self.softened, self._program = True, softened(self._program, self._slack_price)
            self._solver = self._set_up()
            return self.solve(pull)
        if exact.status in REASONS:
            raise AlgorithmError(f"the local problem has no solution: {REASONS[exact.status]}")
        raise AlgorithmError(
            f"no solution of the local problem was found: the solver is out of iterations at a relative residual of "
            f"{exact.residual:.1g}"
        )

    def _set_up(self) -> osqp.OSQP:
        program, slope, solver = self._program, self._cost * self._length, osqp.OSQP()
        solver.setup(
            sparse.csc_matrix(np.triu(program.M) * (slope * self._length)), program.r * slope,
            sparse.csc_matrix(program.G), program.low / self._length, program.high / self._length,
            verbose=False, eps_abs=TOLERANCE, eps_rel=TOLERANCE, max_iter=20_000, check_termination=CHECK_EVERY,
            adaptive_rho_interval=25,  # in iterations, not in time: the same bits again
        )  # fmt: skip
        return solver


def _units(program: VariationalInequality) -> tuple[float, float]:
    """Return the factor of the cost and the unit of decisions: powers of two, 1 for data of the usual size."""
    steep = float(abs(program.M).max(initial=0.0))
    norms = abs(program.G).max(axis=1, initial=0.0)
    limits = np.concatenate((program.low, program.high)) / np.tile(np.where(norms > 0, norms, 1.0), 2)
    least = float(abs(program.r).max(initial=0.0)) / steep if steep else 0.0
    length = _power(max(float(abs(limits[np.isfinite(limits)]).max(initial=0.0)), least))
    return 1.0 / _power(max(steep * length**2, float(abs(program.r).max(initial=0.0)) * length)), length


def _power(size: float) -> float:
    return 1.0 if size == 0 or USUAL[0] <= size <= USUAL[1] else float(2.0 ** np.round(np.log2(size)))
