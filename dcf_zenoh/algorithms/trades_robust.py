"""Primal-dual TRADES that finds the exact equilibrium although messages are lost or late.

`trades` keeps the sum of its trackers at zero, and every lost message breaks that for good. Here a relaxed ADMM over
the edges tracks the means. It has no sum to keep: whatever was lost, what comes later puts right.

Sources: for the game, Carnevale, Fabiani, Fele, Margellos, Notarstefano, "Tracking-based distributed equilibrium
seeking for aggregative games", IEEE TAC 2024; for the tracker, Carnevale, Bastianello, Notarstefano, Carli,
"ADMM-Tracking Gradient for Distributed Optimization over Asynchronous and Unreliable Networks", IEEE TAC 2025, which
tracks a gradient where this tracks contributions and constraints.
"""

from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from dcf_zenoh.algorithms.algorithm import Inbox, Me, PerNeighbour, Result
from dcf_zenoh.algorithms.coupled_game import CoupledGame
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array


class _Settings(NamedTuple):
    """delta, gamma, N rho, alpha and the bound of the multipliers of the game; rho and alpha of ADMM."""

    relax: float
    step: float
    dual: float
    blend: float
    multiplier_max: float
    penalty: float
    renew: float


def trades_robust(
    game: CoupledGame,
    me: Me,
    *,
    relax: float = 0.6,
    step: float = 0.05,
    dual: float = 1.2,
    blend: float = 1.0,
    multiplier_max: float = 1e3,
    penalty: float = 1.0,
    renew: float = 0.9,
) -> Generator[tuple[PerNeighbour, float], Inbox, Result]:
    """Seek the variational generalised Nash equilibrium of `game` over links that lose and delay messages.

    A round is one gradient step, adapt-then-combine as in `trades`, and one step of the tracker. The trackers start
    anew in every control step, the multipliers are kept. The residual is the largest primal or dual change.

    The multipliers are mixed by any row-stochastic weights, so that a missing neighbour's weight may go to the agent
    itself and a held value may stand in for a new one: in the equilibrium they are equal everywhere and none of this
    moves them.

    Args:
        game: This agent's share of the game.
        me: This agent.
        relax: delta in (0, 1]; how far to go towards the projected step.
        step: gamma, the primal step size.
        dual: N rho, the dual step size times the number of agents.
        blend: alpha in (0, 1], how far the multipliers follow.
        multiplier_max: Bound of the multipliers: the price of violating a constraint in a step without solution.
        penalty: rho of the tracker; the larger, the more the neighbours' estimates weigh.
        renew: alpha of the tracker in (0, 1], how far an edge follows what comes over it.

    Raises:
        AlgorithmError: A setting is out of range, or a link has no opposite.
    """
    hears, tells = me.neighbours, me.neighbourhood.sends_to
    if hears != tells:
        raise AlgorithmError(
            f"trades_robust needs links in both directions; agent {me.id} hears {list(hears)} and is heard by"
            f" {list(tells)} (use an undirected topology)"
        )
    use = _Settings(relax, step, dual, blend, multiplier_max, penalty, renew)
    for name, value, most in zip(use._fields, use, (1.0, np.inf, np.inf, 1.0, np.inf, np.inf, 1.0), strict=True):
        if not 0 < value <= most:
            raise AlgorithmError(f"trades_robust: {name} must be in (0, {most:g}], not {value:g}")

    u, lam = game.start(me.last), me.recall("lam", np.zeros(game.rows))
    phi = game.contribution(u)
    size = len(phi)  # theta = [phi(u), A u - b]; what is tracked is its mean over the fleet
    tracker = _Tracker(np.concatenate((phi, game.coupling(u))), use.penalty, use.renew)
    while True:
        s, c = tracker.mean[:size], tracker.mean[size:]
        mu = np.minimum(np.maximum(lam + use.dual * c, 0.0), use.multiplier_max)
        new = u + use.relax * (game.project(u - use.step * (game.gradient(u, s) + mu @ game.A)) - u)
        nu = lam + use.blend * (mu - lam)
        change = max(float(abs(new - u).max()), float(abs(nu - lam).max(initial=0.0)))
        u = new
        tracker.track(np.concatenate((game.contribution(u), game.coupling(u))))
        inbox = yield PerNeighbour({j: {"edge": tracker.edge(j), "lam": nu} for j in tells}), change
        lam = nu.copy()
        for j, payload in inbox.items():
            lam += me.neighbourhood.weights[j] * (payload["lam"] - nu)
            if inbox.new(j):  # a held message must not count twice
                tracker.hear(j, np.asarray(payload["edge"]))
        tracker.combine()
        me.note(u=u, lam=lam, mean=tracker.mean)
        if inbox.stop:
            return me.result(u, lam=lam)


class _Tracker:
    """Tracks the mean over the fleet of a vector theta of each agent, by relaxed ADMM over the edges.

    The agents minimise sum_i |x_i - theta_i|^2 / 2 under x_i = x_j on every edge, which the mean solves, from any
    start. An edge counts once something has come over it: an edge that is silent for the whole step would pull x
    towards whatever it started from.

    Source: Carnevale et al. 2025, its robust variant, with q for z.

    Args:
        theta: This agent's vector at first, shape (n,).
        penalty: rho.
        renew: alpha.

    Attributes:
        mean: x_i, this agent's estimate, shape (n,).
    """

    def __init__(self, theta: Array, penalty: float, renew: float) -> None:
        self._theta = self.mean = theta
        self._penalty, self._renew = penalty, renew
        self._q: dict[int, Array] = {}  # of the edges over which something has come

    def track(self, theta: Array) -> None:
        """Go on with a new vector of this agent."""
        self._theta = theta
        self.combine()

    def combine(self) -> None:
        """Form the estimate x = (theta + sum_j q_ij) / (1 + rho d)."""
        total = self._theta
        for _, q in sorted(self._q.items()):
            total = total + q
        self.mean = total / (1 + self._penalty * len(self._q))

    def edge(self, neighbour: int) -> Array:
        """What `neighbour` is to hear: -q_ij + 2 rho x."""
        return 2 * self._penalty * self.mean - self._edge(neighbour)

    def hear(self, neighbour: int, message: Array) -> None:
        """Take in what `neighbour` sent: q_ij <- (1 - alpha) q_ij + alpha m_ji."""
        self._q[neighbour] = (1 - self._renew) * self._edge(neighbour) + self._renew * message

    def _edge(self, neighbour: int) -> Array:
        """q_ij; before anything was heard rho x, with which the edge does not move x."""
        return self._q[neighbour] if neighbour in self._q else self._penalty * self.mean
