"""ADMM-tracking gradient: gradient tracking that tolerates lost and late messages."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, PerNeighbour, Result
from dcf_zenoh.algorithms.needs import Fraction, needs
from dcf_zenoh.algorithms.shared.mean_tracker import MeanTracker, TrackerOptions
from dcf_zenoh.problems.problem import ConsensusProblem
from dcf_zenoh.spec import PositiveFloat

_TRACKER = TrackerOptions(penalty=0.5)


@needs(ConsensusProblem, traits=("smooth", "unconstrained"), links="undirected", alike=True, uses=("gradient",))
def admm_tracking_gradient(
    problem: ConsensusProblem,
    me: Me,
    *,
    step: PositiveFloat = 0.2,
    relax: Fraction = 0.5,
    tracker: TrackerOptions = _TRACKER,
) -> Dialogue[Result]:
    """Step towards the mean decision and against the mean gradient: ``x+ = x + gamma (y - x) - gamma a s``.

    y and s are this agent's estimates of the means of x and of grad f(x), tracked by ADMM over the edges, whose limit
    depends neither on their start nor on lost messages. Payloads are per neighbour. Converges linearly for strongly
    convex costs and small gamma. The residual is the largest change of x or distance of x to y.

    Args:
        problem: Cost of this agent.
        me: This agent.
        step: a, the step size.
        relax: gamma, the fraction of the step to take.
        tracker: Options of the tracker of the means.

    Source: Carnevale, Bastianello, Notarstefano, Carli, "ADMM-Tracking Gradient for Distributed Optimization over
    Asynchronous and Unreliable Networks", IEEE Transactions on Automatic Control, 2025, Algorithms 1 and 2.
    """
    x = problem.start(me.last)
    means = MeanTracker(np.concatenate((x, problem.gradient(x))), tracker)
    change = float("inf")
    while True:
        inbox = yield PerNeighbour({j: {"m": means.message(j)} for j in me.neighbours}), change
        for j, payload in inbox.items():
            if inbox.new(j):  # a held value must not count twice
                means.update(j, np.asarray(payload["m"]))
        means.combine()
        y, s = np.split(means.mean, 2)
        new = x + relax * (y - x - step * s)
        change, x = max(float(abs(new - x).max()), float(abs(y - x).max())), new
        means.track(np.concatenate((x, problem.gradient(x))))
        me.note(x=x)
        if inbox.stop:
            return me.result(x)


admm_tracking_gradient.RENAMED = {"penalty": "tracker.penalty", "renew": "tracker.renew"}  # type: ignore[attr-defined]
