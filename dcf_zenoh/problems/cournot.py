"""Firms that sell the same good: the more they make together, the lower its price."""

import numpy as np

from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.problems.problem import CoupledGame, Game
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.box import Box


class Cournot(CoupledGame, Game):
    """Each agent chooses how much of a good to make; the more all make, the lower its price.

    An agent minimises J_i = c x_i - x_i (price - slope sum_j x_j) over x_i >= 0. Price and slope are
    the same at all agents. The amount that all make is observed, or estimated as N sigma, with sigma the mean over the
    fleet. With a capacity, sum_i x_i <= capacity.

    Args:
        agent: Id of this agent.
        agents: Ids of all agents, ascending.
        cost: c.
        price: Price where nothing is made.
        slope: Fall of the price for each piece that is made; positive.
        capacity: Most that all together can make; None: no limit.
        upper: Most that the agent can make; None: no limit.

    Raises:
        ValueError: The slope is not positive, or a limit is negative.

    Source: Cournot, "Recherches sur les principes mathématiques de la théorie des richesses", 1838, Chapter VII.
    """

    SHARED = ("price", "slope", "capacity")

    def __init__(
        self,
        agent: int,
        agents: tuple[int, ...],
        *,
        cost: float,
        price: float = 10.0,
        slope: float = 1.0,
        capacity: float | None = None,
        upper: float | None = None,
    ) -> None:
        if not slope > 0:
            raise ValueError(f"slope must be positive, not {slope}")
        if capacity is not None and capacity < 0:
            raise ValueError(f"capacity must not be negative, and is {capacity}")
        self.players = agents
        self.size = 1
        self.rows = 0 if capacity is None else 1
        self.A = read_only(np.ones((self.rows, 1)))
        self.b = read_only(np.full(self.rows, (capacity or 0.0) / len(agents)))
        self._place = agents.index(agent)
        self._margin = cost - price
        self._slope = slope
        self._box = Box.of(1, 0.0, upper)

    def start(self, last: Array | None) -> Array:
        """Return the amount of the last decision, or 0."""
        return np.zeros(1) if last is None else last

    def contribution(self, u: Array) -> Array:
        """Return the amount that the agent makes."""
        return u

    def gradient(self, u: Array, sigma: Array) -> Array:
        """Return the derivative of J_i where the others make N sigma - u."""
        return self._margin + self._slope * (len(self.players) * sigma + u)

    def pseudo_gradient(self, profile: Array) -> Array:
        """Return the derivative of J_i where all make `profile`."""
        return self.gradient(profile[self._place], profile.mean(axis=0))

    def coupling(self, u: Array) -> Array:
        """Return the amount that the agent makes beyond its part of the capacity."""
        return self.A @ u - self.b

    def project(self, u: Array) -> Array:
        """Return the nearest amount that the agent can make."""
        return self._box.nearest(u)

    def share(self) -> Share:
        """Return the problem as arrays."""
        one, zero = np.eye(1), np.zeros(1)
        return Share(
            self._slope * one,
            np.array([self._margin]),
            *self._box,
            K=self._slope * len(self.players) * one,
            Phi=one,
            phi=zero,
            A=self.A,
            b=self.b,
        )
