"""Primal TRADES: tracking-based seeking of the Nash equilibrium of an aggregative game."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import Fraction, needs
from dcf_zenoh.problems.problem import AggregativeGame
from dcf_zenoh.spec import PositiveFloat


@needs(AggregativeGame, traits=("uncoupled",), doubly_stochastic=True, alike=True)
def trades_primal(
    game: AggregativeGame, me: Me, *, relax: Fraction = 0.6, step: PositiveFloat = 0.1
) -> Dialogue[Result]:
    """Take projected pseudo-gradient steps at a tracked estimate s of the mean contribution sigma.

    ``s = phi(u) + z``, ``u+ = u + delta (P[u - gamma F(u, s)] - u)``, ``z+ = sum_j w_ij s_j - phi(u)``; s is sent. The
    trackers z start at zero in every control step and must sum to zero over the fleet, so a lost message leaves a bias
    until the end of the step. Converges linearly for a strongly monotone pseudo-gradient and small steps. The residual
    is the largest change of u or s.

    Args:
        game: Cost and set of this agent.
        me: This agent.
        relax: delta, the fraction of the projected step to take.
        step: gamma, the step size.

    Source: Carnevale, Fabiani, Fele, Margellos, Notarstefano, "Tracking-based distributed equilibrium seeking for
    aggregative games", IEEE Transactions on Automatic Control, 2024, Algorithm 1.
    """
    u = game.start(me.last)
    phi = game.contribution(u)
    z = np.zeros_like(phi)
    change = float("inf")
    while True:
        s = phi + z
        inbox = yield {"s": s}, change
        new = u + relax * (game.project(u - step * game.gradient(u, s)) - u)
        z = me.mix(inbox, "s") - phi
        phi = game.contribution(new)
        change = max(float(abs(new - u).max()), float(abs(phi + z - s).max()))
        u = new
        me.note(u=u, z=z)
        if inbox.stop:
            return me.result(u)
