"""Sparse regression on data that the agents hold in parts."""

import numpy as np

from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.box import Box

SWEEPS = 10_000  # over all coordinates; far more than are needed


class Lasso(ConsensusProblem):
    """Sparse regression on rows of A and b that the agents hold: the least |A x - b|² / 2 + l1 sum_k |x_k|.

    The data are made up: A and the noise are normal, b = A x_true + noise, and x_true has few entries that are not 0.

    Args:
        agent: Id of this agent; it has rows of its own.
        agents: Ids of all agents; each pays for its part of l1.
        size: n, entries of x.
        rows: Rows of A and b that the agent holds.
        nonzero: Entries of x_true that are not 0.
        noise: Standard deviation.
        l1: Price of the sum of absolute values.
        seed: Seed of the data.

    Raises:
        ValueError: A number is out of its range.

    Source: Tibshirani, "Regression shrinkage and selection via the lasso", Journal of the Royal Statistical Society,
    Series B, 1996.
    """

    SHARED = ("size", "nonzero", "noise", "l1", "seed")
    smooth = False
    strongly_convex = False  # an agent may hold fewer rows than x has entries

    def __init__(
        self,
        agent: int,
        agents: tuple[int, ...],
        *,
        size: int = 8,
        rows: int = 10,
        nonzero: int = 3,
        noise: float = 0.1,
        l1: float = 2.0,
        seed: int = 0,
    ) -> None:
        for name, value in (("size", size), ("rows", rows)):
            if value < 1:
                raise ValueError(f"{name} must be at least 1, not {value}")
        if not 0 <= nonzero <= size:
            raise ValueError(f"nonzero must be from 0 to size, which is {size}, not {nonzero}")
        for name, least in (("noise", noise), ("l1", l1), ("seed", seed)):
            if not least >= 0:
                raise ValueError(f"{name} must not be negative, and is {least}")
        self.size = size
        common = np.random.Generator(np.random.Philox([seed, 0, 1]))
        truth = np.zeros(size)
        truth[common.choice(size, nonzero, replace=False)] = common.choice([-1.0, 1.0], nonzero)
        own = np.random.Generator(np.random.Philox([seed, agent, 2]))
        self.A = read_only(own.normal(size=(rows, size)))
        self.b = read_only(self.A @ truth + noise * own.normal(size=rows))
        self._l1 = l1 / len(agents)
        self._hessian = self.A.T @ self.A
        self._slope = -(self.A.T @ self.b)

    def cost(self, x: Array) -> float:
        """Return |A x - b|² / 2 over the agent's rows, plus its part of l1 sum_k |x_k|."""
        missed = self.A @ x - self.b
        return float(missed @ missed) / 2 + self._l1 * float(abs(x).sum())

    def gradient(self, x: Array) -> Array:
        """Return a subgradient; that of |x_k| is 0 at 0."""
        slope: Array = self._hessian @ x + self._slope + self._l1 * np.sign(x)
        return slope

    def argmin(self, slope: Array, weight: float) -> Array:
        """Return the minimiser: coordinate descent finds the entries that are not 0, and a linear system their values.

        Source: Friedman, Hastie, Höfling, Tibshirani, "Pathwise coordinate optimization", Annals of Applied Statistics,
        2007.
        """
        Q, p = self._hessian + weight * np.eye(self.size), self._slope + slope
        x = np.zeros(self.size)
        for _ in range(SWEEPS):
            for k in range(self.size):
                rest = p[k] + Q[k] @ x - Q[k, k] * x[k]
                x[k] = -np.sign(rest) * max(abs(rest) - self._l1, 0.0) / Q[k, k]
            exact = self._exact(Q, p, np.sign(x))
            if exact is not None:
                return exact
        return x

    def _exact(self, Q: Array, p: Array, signs: Array) -> Array | None:
        """Return the minimiser if its entries have these signs, else None."""
        used = signs != 0
        x = np.zeros(self.size)
        x[used] = np.linalg.solve(Q[np.ix_(used, used)], -p[used] - self._l1 * signs[used])
        idle = abs(Q @ x + p)[~used].max(initial=0.0)
        return x if (np.sign(x) == signs).all() and idle <= self._l1 * (1 + 1e-12) else None

    def share(self) -> Share:
        """Return the problem as arrays."""
        return Share(
            self._hessian,
            self._slope,
            *Box.of(self.size, None, None),
            absolute=np.full(self.size, self._l1),
            kink=np.zeros(self.size),
            common=True,
        )
