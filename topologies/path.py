"""Path graph."""

from collections.abc import Sequence
from itertools import pairwise


def path(agents: Sequence[int]) -> list[tuple[int, int]]:
    """Each agent and the next one, in order of ids, hear each other; the two ends have one neighbour.

    Args:
        agents: Ids, ascending.

    Returns:
        Links (sender, receiver).
    """
    return [link for i, j in pairwise(agents) for link in ((i, j), (j, i))]
