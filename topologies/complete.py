"""Complete graph."""

from collections.abc import Sequence
from itertools import permutations


def complete(agents: Sequence[int]) -> list[tuple[int, int]]:
    """Every agent hears every other.

    Args:
        agents: Ids, ascending.

    Returns:
        Links (sender, receiver).
    """
    return list(permutations(agents, 2))
