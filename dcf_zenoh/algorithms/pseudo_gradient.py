"""Gradient play with full information: every player receives every action."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import Game
from dcf_zenoh.spec import PositiveFloat


@needs(Game, traits=("uncoupled",), links="complete")
def pseudo_gradient(problem: Game, me: Me, *, step: PositiveFloat = 0.1) -> Dialogue[Result]:
    """Step against the gradient of the player's own cost at the actions received: ``x+ = P[x - a F_i]``.

    Converges linearly for a strongly monotone pseudo-gradient and small steps. A missing action is replaced by the last
    one received, or by 0. The residual is the change of the player's action.

    Args:
        problem: Cost and set of this player.
        me: This agent, which must receive from all others.
        step: a; less than 2 m / L² for an m-strongly monotone pseudo-gradient with Lipschitz constant L.

    Source: Facchinei and Pang, "Finite-dimensional variational inequalities and complementarity problems", 2003,
    Section 12.1.
    """
    place = problem.players.index(me.id)
    seen = np.zeros((len(problem.players), problem.size))
    x = problem.project(np.zeros(problem.size) if me.last is None else me.last)
    change = float("inf")
    while True:
        inbox = yield {"x": x}, change
        seen[place] = x
        for row, player in enumerate(problem.players):
            if player in inbox:
                seen[row] = inbox[player]["x"]
        new = problem.project(x - step * problem.pseudo_gradient(seen))
        change, x = float(abs(new - x).max()), new
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
