"""Push-sum: the mean on a directed graph."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import MeanProblem


@needs(MeanProblem, alike=True)
def push_sum(problem: MeanProblem, me: Me) -> Dialogue[Result]:
    """Find the mean of all agents' values on any strongly connected graph.

    Each agent holds a mass s and a weight w, divides both evenly among itself and its out-neighbours, and adds up what
    it receives. The totals over the fleet are kept, and ``s / w`` tends to the mean. A lost message loses its mass for
    good, so the network must not lose any. The residual is the change of the agent's estimate.

    Source: Kempe, Dobra, Gehrke, "Gossip-based computation of aggregate information", FOCS 2003; with a broadcast to
    all out-neighbours as in Nedić and Olshevsky, "Distributed optimization over time-varying directed graphs", IEEE
    Transactions on Automatic Control, 2015, Section II.
    """
    s, w = np.asarray(problem.value), 1.0
    x = s / w
    parts = len(me.neighbourhood.sends_to) + 1
    change = float("inf")
    while True:
        inbox = yield {"s": s / parts, "w": w / parts}, change
        parts_in = sorted([(me.id, inbox.own), *((j, inbox[j]) for j in inbox if inbox.new(j))])
        s = np.sum([np.asarray(payload["s"]) for _, payload in parts_in], axis=0)
        w = sum(float(payload["w"]) for _, payload in parts_in)
        change, x = float(abs(s / w - x).max()), s / w
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
