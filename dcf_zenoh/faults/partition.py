"""Partition: a fleet falls apart into groups."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.messaging.delivery import Delivery


class Partition(Fault):
    """Loss of all messages from one group of agents to another; the links of agents in no group are not affected.

    Args:
        sender: Id of the sending agent.
        receiver: Id of the receiving agent.
        groups: Ids of the agents of each group.

    Raises:
        ValueError: There are fewer than two groups, one is empty, or an agent is named twice.
    """

    STAGE = Stage.CUT
    AGENTS = ("groups",)

    def __init__(self, sender: int, receiver: int, *, groups: tuple[tuple[int, ...], ...]) -> None:
        if len(groups) < 2 or not all(groups):
            raise ValueError(f"groups must be at least two, such as [[1, 2], [3, 4]], none empty, not {groups}")
        twice = [agent for agent, times in Counter(agent for group in groups for agent in group).items() if times > 1]
        if twice:
            raise ValueError(f"groups must name an agent once, not agent {twice[0]} twice")
        home = {agent: index for index, group in enumerate(groups) for agent in group}
        self._cut = sender in home and receiver in home and home[sender] != home[receiver]

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:  # noqa: ARG002
        """Return the delivery, or nothing if the link crosses groups."""
        return () if self._cut else (delivery,)
