"""Gradient play with partial information: players estimate the actions that they do not receive."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import Game
from dcf_zenoh.spec import PositiveFloat


@needs(Game, traits=("uncoupled",), doubly_stochastic=True, alike=True)
def pseudo_gradient_partial(problem: Game, me: Me, *, step: PositiveFloat = 0.1) -> Dialogue[Result]:
    """Mix estimates X of all actions with the neighbours', and take a gradient step in the player's own row.

    ``V = sum_j w_ij X_j``, then ``X+ = V`` except for the player's own row, ``P[V_i - a F_i(V)]``. Converges linearly
    for a strongly monotone pseudo-gradient and small steps; the bound of the step depends on the graph. The residual is
    the largest change of an estimate.

    Args:
        problem: Cost and set of this player.
        me: This agent.
        step: a.

    Source: Tatarenko, Shi, Nedić, "Geometric convergence of gradient play algorithms for distributed Nash equilibrium
    seeking", IEEE Transactions on Automatic Control, 2021.
    """
    place = problem.players.index(me.id)
    X = me.recall("X", np.zeros((len(problem.players), problem.size)))
    change = float("inf")
    while True:
        inbox = yield {"X": X}, change
        V = me.mix(inbox, "X")
        new = np.array(V)
        new[place] = problem.project(V[place] - step * problem.pseudo_gradient(V))
        change, X = float(abs(new - X).max()), new
        me.note(x=X[place])
        if inbox.stop:
            return me.result(X[place], X=X)
