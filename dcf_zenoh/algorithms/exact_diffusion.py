"""Exact diffusion."""

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
def exact_diffusion(problem: ConsensusProblem, me: Me, *, step: PositiveFloat = 0.2) -> Dialogue[Result]:
    """Adapt, correct, combine: ``psi = x - a grad f(x), phi = psi + x - psi_before, x+ = (phi + W phi) / 2``.

    Without the correction it is diffusion, whose constant steps leave a bias. It sends one vector and converges
    linearly for strongly convex costs and symmetric W, with larger steps than EXTRA. A lost message leaves a bias. The
    residual is the change of x.

    Args:
        problem: Cost of this agent.
        me: This agent.
        step: a; less than 2 / L for gradients with Lipschitz constant L.

    Source: Yuan, Ying, Zhao, Sayed, "Exact diffusion for distributed optimization and learning - Part I: algorithm
    development", IEEE Transactions on Signal Processing, 2019, Algorithm 1.
    """
    x = before = problem.start(me.last)
    change = float("inf")
    while True:
        psi = x - step * problem.gradient(x)
        inbox = yield {"phi": psi + x - before}, change
        new = (psi + x - before + me.mix(inbox, "phi")) / 2
        change, x, before = float(abs(new - x).max()), new, psi
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
