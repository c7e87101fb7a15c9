"""Structures of the problems that a fleet can solve: each is an interface with what algorithms need of it.

A problem is one agent's share of what the fleet solves together. Its class derives from one structure or several; an
algorithm names the structure that it solves, and refuses the others (`dcf_zenoh.algorithms.needs`).
Shapes: (n,) for decisions, (s,) for contributions of the players of a game, (rows,) for shared constraints.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection
from typing import ClassVar

import numpy as np

from dcf_zenoh.plant import Array


class Problem:
    """One agent's share of a problem.

    Attributes:
        STRUCTURE: Name of the structure in messages, with its article.
    """

    STRUCTURE: ClassVar[str] = "a problem"


class MeanProblem(Problem):
    """The mean over the fleet of the agents' values.

    Attributes:
        value: This agent's value, shape (n,), the same n at every agent.
    """

    STRUCTURE = "a mean of values"
    value: Array


class ConsensusProblem(Problem):
    """Minimise sum_i f_i(x) over one x for all agents, in the intersection of their sets X_i; f_i and X_i are convex.

    An algorithm calls `gradient` or `argmin`, not both, and states which; the other one, and `cost`, may be left out.

    Attributes:
        size: n, the same at every agent.
        smooth: Whether f has a gradient everywhere.
        strongly_convex: Whether f grows at least like a square in all directions, so that it has a unique minimiser.
        unconstrained: Whether X is the whole space.
    """

    STRUCTURE = "a consensus problem"
    size: int
    smooth: bool = True
    strongly_convex: bool = True
    unconstrained: bool = True

    def start(self, last: Array | None) -> Array:
        """Return the start of the iteration: the last decision, or else 0."""
        return np.zeros(self.size) if last is None else last

    def cost(self, x: Array) -> float:
        """Return f(x)."""
        raise NotImplementedError(f"{type(self).__name__} has no method cost")

    def gradient(self, x: Array) -> Array:
        """Return the gradient of f, or a subgradient."""
        raise NotImplementedError(f"{type(self).__name__} has no method gradient")

    def argmin(self, slope: Array, weight: float) -> Array:
        """Return the x in X with the least f(x) + slope'x + weight / 2 |x|².

        Args:
            slope: Shape (n,).
            weight: Not negative; positive if f is not strongly convex.
        """
        raise NotImplementedError(f"{type(self).__name__} has no method argmin")

    def project(self, x: Array) -> Array:
        """Return the nearest point of X."""
        return x


class CoupledProblem(Problem):
    """Minimise sum_i f_i(x_i) over a decision of each agent in its set X_i, under sum_i (A_i x_i - b_i) = 0, or <= 0.

    `cost` may be left out: no algorithm calls it.

    Attributes:
        A: Shape (rows, n).
        b: Shape (rows,).
        rows: Number of shared constraints.
        equality: Whether the shared constraints are equations.
        strongly_convex: Whether f grows at least like a square in all directions.
    """

    STRUCTURE = "a problem with shared constraints"
    A: Array
    b: Array
    rows: int
    equality: bool = True
    strongly_convex: bool = True

    def cost(self, x: Array) -> float:
        """Return f(x)."""
        raise NotImplementedError(f"{type(self).__name__} has no method cost")

    def respond(self, price: Array, weight: float, target: Array) -> Array:
        """Return the x in X with the least f(x) + price'A x + weight / 2 |A x - target|².

        Args:
            price: Multipliers of the shared constraints, shape (rows,).
            weight: Not negative; positive if f is not strongly convex.
            target: Shape (rows,).
        """
        raise NotImplementedError(f"{type(self).__name__} has no method respond")

    def coupling(self, x: Array) -> Array:
        """Return A x - b."""
        shares: Array = self.A @ x - self.b
        return shares


class Game(Problem, ABC):
    """Each agent minimises a cost of its own over its action x_i in X_i; the cost depends on all actions.

    Attributes:
        players: Ids of all agents, ascending, in the order of the rows of a profile.
        size: n, the same for all players.
    """

    STRUCTURE = "a game"
    players: tuple[int, ...]
    size: int

    @property
    def uncoupled(self) -> bool:
        """Whether there are no shared constraints."""
        return True

    @abstractmethod
    def pseudo_gradient(self, profile: Array) -> Array:
        """Return F_i, the gradient of this agent's cost with regard to its own action, at `profile`, shape (N, n)."""

    def project(self, x: Array) -> Array:
        """Return the nearest point of X."""
        return x


class AggregativeGame(Problem, ABC):
    """A game whose costs depend on the own decision u and on sigma, the mean over the fleet of contributions phi(u).

    Attributes:
        lost: Agents that take no part.
    """

    STRUCTURE = "an aggregative game"
    lost: Collection[int] = ()

    @property
    def uncoupled(self) -> bool:
        """Whether there are no shared constraints."""
        return True

    @abstractmethod
    def start(self, last: Array | None) -> Array:
        """Return the initial decision, given that of the last control step, if any."""

    @abstractmethod
    def contribution(self, u: Array) -> Array:
        """Return phi(u), whose mean over the agents is sigma."""

    @abstractmethod
    def gradient(self, u: Array, sigma: Array) -> Array:
        """Return the pseudo-gradient: the derivative of the agent's cost by u, including that through sigma."""

    @abstractmethod
    def project(self, u: Array) -> Array:
        """Return the nearest admissible decision."""


class CoupledGame(AggregativeGame):
    """An aggregative game under shared constraints sum_i (A_i u_i - b_i) <= 0.

    Attributes:
        A: Shape (rows, n).
        rows: Number of shared constraints.
    """

    STRUCTURE = "an aggregative game with shared constraints"
    A: Array
    rows: int

    @property
    def uncoupled(self) -> bool:
        """Whether there are no shared constraints."""
        return self.rows == 0

    @abstractmethod
    def coupling(self, u: Array) -> Array:
        """Return A u - b; the sum over the agents must not be positive."""


class NonlinearGame(AggregativeGame):
    """An aggregative game under shared constraints c(y) <= 0, smooth but not linear, on outputs y_i = T_i u_i + t_i.

    Each agent knows the constraints in which it takes part. Outputs are those of all agents, in order of ids, shape
    (N, m).

    Attributes:
        agents: Ids of all agents, ascending.
        T: Shape (m, n).
        t: Shape (m,).
        linear: Whether the shared constraints are linear.
    """

    STRUCTURE = "an aggregative game with constraints that are not linear"
    linear: bool = False
    agents: tuple[int, ...]
    T: Array
    t: Array

    @property
    def uncoupled(self) -> bool:
        """Whether there are no shared constraints."""
        return False

    @abstractmethod
    def constraints(self, outputs: Array) -> tuple[Array, Array]:
        """Return c, shape (limits,), and its derivative, shape (limits, N, m)."""

    def curvature(self, outputs: Array, prices: Array) -> Array:  # noqa: ARG002
        """Return a positive semidefinite part of the second derivative of prices'c, shape (N m, N m).

        Args:
            outputs: Shape (N, m).
            prices: Multipliers of the constraints, not negative, shape (limits,).
        """
        return np.zeros((outputs.size, outputs.size))
