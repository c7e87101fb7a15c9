"""Gradient play where every action is seen."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import Game
from dcf_zenoh.spec import PositiveFloat


@needs(Game, traits=("uncoupled",), links="complete")
def pseudo_gradient(problem: Game, me: Me, *, step: PositiveFloat = 0.1) -> Dialogue[Result]:
    """Each player steps against the gradient of its own cost, at the actions that all have told: ``x+ = P[x - a F_i]``.

    Linear where the pseudo-gradient is strongly monotone and the step small. For an action that was not heard the last
    one stands that was, or 0. The residual is the change of the own action.

    Args:
        problem: This player's cost and set.
        me: This agent, which must hear all others.
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
