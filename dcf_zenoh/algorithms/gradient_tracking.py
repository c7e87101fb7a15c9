"""Gradient tracking."""

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.spec import PositiveFloat


@needs(ConsensusProblem, traits=("smooth", "unconstrained"), doubly_stochastic=True, alike=True, uses=("gradient",))
def gradient_tracking(problem: ConsensusProblem, me: Me, *, step: PositiveFloat = 0.1) -> Dialogue[Result]:
    """Descend along an estimate y of the mean gradient: ``x+ = W (x - a y), y+ = W y + grad f(x+) - grad f(x)``.

    Each estimate starts at the agent's own gradient. Their mean over the fleet must be kept, so a lost message leaves a
    bias for good. Converges linearly for strongly convex costs and small steps. The residual is the largest change of x
    or of the step to come.

    Args:
        problem: Cost of this agent.
        me: This agent.
        step: a; less than about 1 / L for gradients with Lipschitz constant L.

    Source: Di Lorenzo and Scutari, "NEXT: in-network nonconvex optimization", IEEE Transactions on Signal and
    Information Processing over Networks, 2016; its rate: Nedić, Olshevsky, Shi, "Achieving geometric convergence for
    distributed optimization over time-varying graphs", SIAM Journal on Optimization, 2017, whose step is not mixed.
    """
    x = problem.start(me.last)
    y = own = problem.gradient(x)
    change = float("inf")
    while True:
        inbox = yield {"x": x - step * y, "y": y}, change
        new = me.mix(inbox, "x")
        gradient = problem.gradient(new)
        y = me.mix(inbox, "y") + gradient - own
        change = max(float(abs(new - x).max()), step * float(abs(y).max()))
        x, own = new, gradient
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
