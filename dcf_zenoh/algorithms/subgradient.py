"""The distributed projected subgradient method."""

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.spec import NonNegativeFloat, PositiveFloat


@needs(ConsensusProblem, doubly_stochastic=True, alike=True, uses=("gradient",))
def subgradient(
    problem: ConsensusProblem, me: Me, *, step: PositiveFloat = 0.5, decay: NonNegativeFloat = 1.0
) -> Dialogue[Result]:
    """Mix, step against the agent's subgradient, project on its set: ``v = sum_j w_ij x_j, x+ = P[v - a_k g(v)]``.

    With steps a_k = step / (k + 1)^decay, 1/2 < decay <= 1, all agents converge to a minimiser, slowly. With decay = 0
    they approach it at a linear rate and stay at a distance that grows with the step and the differences of the agents'
    gradients there. The residual is the largest change of the agent's estimate or its distance to the mixed one. With
    constant steps it does not vanish, and the smaller the steps, the less it bounds the distance to the minimiser.

    Args:
        problem: Cost and set of this agent.
        me: This agent.
        step: First step size, a_0.
        decay: Exponent by which the steps shrink.

    Source: Nedić, Ozdaglar, Parrilo, "Constrained consensus and optimization in multi-agent networks", IEEE
    Transactions on Automatic Control, 2010, Section IV.
    """
    x = problem.project(problem.start(me.last))
    k, change = 0, float("inf")
    while True:
        inbox = yield {"x": x}, change
        v = me.mix(inbox, "x")
        new = problem.project(v - step / (k + 1) ** decay * problem.gradient(v))
        change, x = max(float(abs(new - x).max()), float(abs(v - x).max())), new
        k += 1
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
