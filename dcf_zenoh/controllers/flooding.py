"""Flooding of the measured states: they are forwarded hop by hop, so that every agent poses the same problem."""

import math
from collections.abc import Generator

import numpy as np

from dcf_zenoh.algorithms.algorithm import Inbox, Me
from dcf_zenoh.controllers.padding import stacked, unstacked
from dcf_zenoh.message import Payload
from dcf_zenoh.plant import Array


def share_states(me: Me, own: Array) -> Generator[tuple[Payload, float], Inbox, tuple[dict[int, Array], bool]]:
    """Flood a table of states for as many rounds as the graph's diameter.

    Args:
        me: This agent.
        own: Measured state of this agent, shape (n,); n may differ between agents.

    Returns:
        Agent -> state of the agents that were received, ascending by id; and whether the step has time left to use
        them.
    """
    table = {me.id: own}
    for _ in range(me.neighbourhood.diameter):
        known = sorted(table)
        inbox = yield {"ids": np.array(known), "states": stacked([table[i] for i in known])}, math.inf
        for j in inbox:
            ids, states = np.asarray(inbox[j]["ids"]), np.asarray(inbox[j]["states"])
            for row, agent in enumerate(ids.tolist()):
                table.setdefault(agent, unstacked(states[row]))
        if inbox.stop:
            return dict(sorted(table.items())), False
    return dict(sorted(table.items())), True
