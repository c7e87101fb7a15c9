"""What an agent must know of the others where constraints are shared: told once in every control step."""

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.central import Whole, assembled
from dcf_zenoh.problems.share import Share


def gather(me: Me, own: Share, plan: Array, lost: Collection[int] = ()) -> Dialogue[dict[int, Share] | None]:
    """Tell how the own decision enters what is shared, and learn it of all others; the own cost is told to nobody.

    All pass on what they know, until they know of all and all neighbours have said the same; lost messages make it
    later. It takes one or two rounds more than the graph's diameter. The residual is infinite.

    Args:
        me: This agent.
        own: Its share.
        plan: Its decision until then, for the log.
        lost: Agents that take no part.

    Returns:
        Agent -> its share, ascending, costs of others being zero; None if the iteration is over before.
    """
    count = sum(i not in lost for i in me.agents)
    waiting = {j for j in me.neighbours if j not in lost}
    known = _without_cost(own).to_payload(me.id)
    while True:
        shares = Share.all_in(known)
        if len(shares) == count and not waiting:
            return {**shares, me.id: own}
        me.note(u=plan)
        inbox = yield known, float("inf")
        for j, payload in inbox.items():
            told = Share.all_in(payload)
            if len(told) in (0, count):  # one that speaks of other things knew all before
                waiting.discard(j)
            known = {**payload, **known} if told else known
        if inbox.stop:
            return None


def local_problem(agent: int, shares: dict[int, Share]) -> Whole:
    """What an agent solves over copies of all decisions: the central problem, but nobody else pays for his own.

    It pays its own cost and one part in N of what the agents pay for the mean, and keeps the constraints that it takes
    part in. The sum over all agents is what they minimise together.

    Raises:
        AlgorithmError: There is no such common cost, as agents pay differently for the mean.
    """
    count = len(shares)
    mine = shares[agent].A.any(axis=1) if shares[agent].A.size else slice(0)
    whole = assembled([
        replace(share, K=share.K / count, A=share.A[mine], b=share.b[mine]) for _, share in sorted(shares.items())
    ])  # fmt: skip
    if not whole.symmetric:
        raise AlgorithmError("the agents have no common cost to minimise, as they pay differently for the fleet's mean")
    return whole


def _without_cost(share: Share) -> Share:
    return replace(share, H=np.zeros_like(share.H), g=np.zeros_like(share.g))
