"""Push-pull: gradient tracking on a directed graph."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.spec import PositiveFloat


@needs(ConsensusProblem, traits=("smooth", "unconstrained"), alike=True, uses=("gradient",))
def push_pull(problem: ConsensusProblem, me: Me, *, step: PositiveFloat = 0.1) -> Dialogue[Result]:
    """Pull decisions and push gradients: ``x+ = R (x - a y), y+ = C y + grad f(x+) - grad f(x)``.

    R holds the mixing weights; its rows sum to 1. The columns of C sum to 1: an agent divides its y evenly among itself
    and its out-neighbours, so the sum of y over the fleet stays the sum of the gradients. Converges linearly for
    strongly convex costs and small steps on any strongly connected graph. A lost message loses its part of y, which
    leaves a bias. The residual is the largest change of x or of the step to come.

    Args:
        problem: Cost of this agent.
        me: This agent.
        step: a.

    Source: Pu, Shi, Xu, Nedić, "Push-pull gradient methods for distributed optimization in networks", IEEE Transactions
    on Automatic Control, 2021.
    """
    x = problem.start(me.last)
    y = own = problem.gradient(x)
    parts = len(me.neighbourhood.sends_to) + 1
    change = float("inf")
    while True:
        inbox = yield {"x": x - step * y, "y": y / parts}, change
        new = me.mix(inbox, "x")
        gradient = problem.gradient(new)
        parts_in = sorted([(me.id, inbox.own), *((j, inbox[j]) for j in inbox if inbox.new(j))])
        y = np.sum([np.asarray(payload["y"]) for _, payload in parts_in], axis=0) + gradient - own
        change = max(float(abs(new - x).max()), step * float(abs(y).max()))
        x, own = new, gradient
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
