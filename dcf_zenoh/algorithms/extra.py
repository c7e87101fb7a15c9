"""EXTRA, an exact first-order algorithm."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.spec import PositiveFloat


@needs(
    ConsensusProblem,
    traits=("smooth", "unconstrained"),
    links="undirected",
    doubly_stochastic=True,
    alike=True,
    uses=("gradient",),
)
def extra(problem: ConsensusProblem, me: Me, *, step: PositiveFloat = 0.2) -> Dialogue[Result]:
    """Descend along the gradient with a correction by the previous round, which removes the bias of constant steps.

    ``x1 = Wx0 - a grad f(x0)``, then ``x++ = x+ + Wx+ - (x + Wx) / 2 - a (grad f(x+) - grad f(x))``. It sends one
    vector and converges linearly for strongly convex costs and symmetric W. A lost message leaves a bias. The residual
    is the change of x.

    Args:
        problem: Cost of this agent.
        me: This agent.
        step: a; less than (1 + least eigenvalue of W) / L for gradients with Lipschitz constant L.

    Source: Shi, Ling, Wu, Yin, "EXTRA: an exact first-order algorithm for decentralized consensus optimization", SIAM
    Journal on Optimization, 2015, Algorithm 1 with (I + W) / 2 for its second matrix.
    """
    x = older = problem.start(me.last)
    before = np.zeros_like(x)
    change = float("inf")
    while True:
        inbox = yield {"x": x}, change
        mixed, gradient = me.mix(inbox, "x"), problem.gradient(x)
        new = x + mixed - older - step * (gradient - before)
        older, before = (x + mixed) / 2, gradient
        change, x = float(abs(new - x).max()), new
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
