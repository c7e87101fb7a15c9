"""Quadratic program that is solved repeatedly while its linear cost changes."""

from typing import NamedTuple

import numpy as np
import osqp
from scipy import sparse
from scipy.linalg import block_diag

from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.problems.central import VariationalInequality

TOLERANCE = 1e-9  # of the solver, absolute and relative
INFEASIBLE = ("primal infeasible", "primal infeasible inaccurate")  # status of OSQP
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
        self._solver = _set_up(self._program)
        self.iterations, self.softened = 0, False
        if warm is not None and (len(warm.v), len(warm.prices)) == (len(whole.r), self._rows):
            self._solver.warm_start(x=np.array(warm.v), y=np.array(warm.prices))

    def solve(self, pull: Array) -> Solution:
        """Return the solution for this `pull`, shape (n,).

        Raises:
            AlgorithmError: There is none, or it was not found; the message has the solver's status.
        """
        n = len(self._r)
        self._solver.update(q=np.concatenate((self._r - pull, self._program.r[n:])))
        found = self._solver.solve(raise_error=False)
        if found.info.status in INFEASIBLE and self._slack_price is not None and not self.softened:
            self.softened, self._program = True, _softened(self._program, self._slack_price)
            self._solver = _set_up(self._program)
            return self.solve(pull)
        if found.info.status != "solved":
            raise AlgorithmError(f"the local problem has no solution: OSQP says {found.info.status}")
        self.iterations = int(found.info.iter)
        return Solution(read_only(found.x[:n]), read_only(found.y[: self._rows]))


def _set_up(program: VariationalInequality) -> osqp.OSQP:
    solver = osqp.OSQP()
    solver.setup(
        sparse.csc_matrix(np.triu(program.M)), program.r, sparse.csc_matrix(program.G), program.low, program.high,
        verbose=False, eps_abs=TOLERANCE, eps_rel=TOLERANCE, max_iter=20_000, check_termination=CHECK_EVERY,
        adaptive_rho_interval=25,  # in iterations, not in time: the same bits again
    )  # fmt: skip
    return solver


def _softened(program: VariationalInequality, price: float) -> VariationalInequality:
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
