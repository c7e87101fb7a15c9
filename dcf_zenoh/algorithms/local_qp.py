"""A quadratic program that is solved again and again while its linear cost changes."""

from typing import NamedTuple

import numpy as np
import osqp
from scipy import sparse

from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.problems.central import Whole

TOLERANCE = 1e-9  # of the solver, absolute and relative
CHECK_EVERY = 5  # iterations; a warm start needs few


class Solution(NamedTuple):
    """Where a solver stands.

    Attributes:
        v: The minimiser, shape (n,), read-only.
        prices: Multipliers of the rows, shape (rows,), positive at an upper limit, read-only.
    """

    v: Array
    prices: Array


class LocalQP:
    """The v with the least v'M v / 2 + r'v + weight / 2 |v|² - pull'v under low <= G v <= high.

    It is asked for one pull after another. OSQP is set up once and keeps its factorisation; each solve starts where the
    last one ended. Its settings count iterations, none is timed, so that the same calls give the same bits.

    Args:
        whole: M, r, G, low and high.
        weight: Not negative; positive if M is not positive definite.
        warm: Where to start the first solve; None, or one of another shape: at zero.

    Attributes:
        iterations: Of OSQP, in the last solve.

    Source: Stellato, Banjac, Goulart, Bemporad, Boyd, "OSQP: an operator splitting solver for quadratic programs",
    Mathematical Programming Computation, 2020.
    """

    def __init__(self, whole: Whole, weight: float, warm: Solution | None = None) -> None:
        n = len(whole.r)
        self._r = whole.r
        self._solver = osqp.OSQP()
        self._solver.setup(
            sparse.csc_matrix(np.triu(whole.M + weight * np.eye(n))), whole.r,
            sparse.csc_matrix(whole.G), whole.low, whole.high,
            verbose=False, eps_abs=TOLERANCE, eps_rel=TOLERANCE, max_iter=20_000, check_termination=CHECK_EVERY,
            adaptive_rho_interval=25,  # counted, never timed: the same bits again
        )  # fmt: skip
        self.iterations = 0
        if warm is not None and (len(warm.v), len(warm.prices)) == (n, len(whole.G)):
            self._solver.warm_start(x=np.array(warm.v), y=np.array(warm.prices))

    def solve(self, pull: Array) -> Solution:
        """The minimiser for this `pull`, shape (n,).

        Raises:
            AlgorithmError: There is none, or it was not found; the message has the solver's status.
        """
        self._solver.update(q=self._r - pull)
        found = self._solver.solve(raise_error=False)
        if found.info.status != "solved":
            raise AlgorithmError(f"the local problem has no solution: OSQP says {found.info.status}")
        self.iterations = int(found.info.iter)
        return Solution(read_only(found.x), read_only(found.y))
