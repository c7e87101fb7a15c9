"""Primal-dual TRADES that finds the exact equilibrium although messages are lost or late.

The trackers of `trades` must sum to zero, which a lost message breaks for the rest of the step. Here a relaxed ADMM
over the edges tracks the means. No sum has to be kept, and later messages make up for lost ones.

Sources: for the game, Carnevale, Fabiani, Fele, Margellos, Notarstefano, "Tracking-based distributed equilibrium
seeking for aggregative games", IEEE TAC 2024; for the tracker, Carnevale, Bastianello, Notarstefano, Carli,
"ADMM-Tracking Gradient for Distributed Optimization over Asynchronous and Unreliable Networks", IEEE TAC 2025, which
tracks a gradient where this tracks contributions and constraints.
"""

from collections.abc import Generator

import numpy as np

from dcf_zenoh.algorithms.algorithm import Inbox, Me, PerNeighbour, Result
from dcf_zenoh.algorithms.needs import Fraction, needs
from dcf_zenoh.algorithms.shared.mean_tracker import MeanTracker, TrackerOptions
from dcf_zenoh.problems.problem import CoupledGame
from dcf_zenoh.spec import PositiveFloat

_TRACKER = TrackerOptions()


@needs(CoupledGame, links="undirected", alike=True)
def trades_robust(
    game: CoupledGame,
    me: Me,
    *,
    relax: Fraction = 0.6,
    step: PositiveFloat = 0.05,
    dual: PositiveFloat = 1.2,
    blend: Fraction = 1.0,
    multiplier_max: PositiveFloat = 1e3,
    tracker: TrackerOptions = _TRACKER,
) -> Generator[tuple[PerNeighbour, float], Inbox, Result]:
    """Seek the variational generalised Nash equilibrium of `game` over links that lose and delay messages.

    A round is one gradient step, adapt-then-combine as in `trades`, and one step of the tracker. The tracker starts
    anew in every control step; the multipliers are kept. The residual is the largest primal or dual change.

    The multipliers are mixed by any row-stochastic weights: at the equilibrium they are equal everywhere, so giving a
    missing neighbour's weight to the agent itself, or using a held value, does not move them.

    Args:
        game: This agent's share of the game.
        me: This agent.
        relax: delta in (0, 1], the fraction of the projected step to take.
        step: gamma, the primal step size.
        dual: N rho, the dual step size times the number of agents.
        blend: alpha in (0, 1], the fraction of the dual step to take.
        multiplier_max: Bound of the multipliers: the price of violating a constraint in a step without a solution.
        tracker: Options of the tracker of the means.

    Raises:
        AlgorithmError: An option is out of range, or a link has no opposite.
    """
    u, lam = game.start(me.last), me.recall("lam", np.zeros(game.rows))
    phi = game.contribution(u)
    size = len(phi)  # theta = [phi(u), A u - b]; what is tracked is its mean over the fleet
    means = MeanTracker(np.concatenate((phi, game.coupling(u))), tracker)
    while True:
        s, c = means.mean[:size], means.mean[size:]
        mu = np.minimum(np.maximum(lam + dual * c, 0.0), multiplier_max)
        new = u + relax * (game.project(u - step * (game.gradient(u, s) + mu @ game.A)) - u)
        nu = lam + blend * (mu - lam)
        change = max(float(abs(new - u).max()), float(abs(nu - lam).max(initial=0.0)))
        u = new
        means.track(np.concatenate((game.contribution(u), game.coupling(u))))
        inbox = yield PerNeighbour({j: {"edge": means.message(j), "lam": nu} for j in me.neighbours}), change
        lam = nu.copy()
        for j, payload in inbox.items():
            lam += me.neighbourhood.weights[j] * (payload["lam"] - nu)
            if inbox.new(j):  # a held value must not count twice
                means.update(j, np.asarray(payload["edge"]))
        means.combine()
        me.note(u=u, lam=lam, mean=means.mean)
        if inbox.stop:
            return me.result(u, lam=lam)


trades_robust.RENAMED = {"penalty": "tracker.penalty", "renew": "tracker.renew"}  # type: ignore[attr-defined]
