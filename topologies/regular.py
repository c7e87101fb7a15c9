"""Random regular graph."""

from collections.abc import Sequence

import numpy as np

from topologies.random_links import connected


def regular(agents: Sequence[int], *, degree: int | None = None, seed: int = 0) -> list[tuple[int, int]]:
    """Every agent has the same number of random neighbours; drawn again until the graph is connected.

    Args:
        agents: Ids, ascending.
        degree: Number of neighbours of each agent; None: 4, or all other agents if there are fewer.
        seed: Seed of the random numbers.

    Returns:
        Links (sender, receiver).

    Raises:
        ValueError: No such graph is connected: `degree` is not less than the number of agents, or less
            than 2 with more than two of them, or both numbers are odd.

    Source: Steger and Wormald, "Generating random regular graphs quickly", Combinatorics, Probability and Computing,
    1999, Algorithm 2.
    """
    count = len(agents)
    each = min(4, count - 1) if degree is None else degree
    least = min(2, count - 1)
    if not least <= each < count:
        raise ValueError(f"degree must be from {least} to {count - 1} with {count} agents, not {each}")
    if each * count % 2:
        raise ValueError(f"degree {each} and {count} agents are both odd: there is no such graph")

    def draw(rng: np.random.Generator) -> list[tuple[int, int]]:
        pairs = None
        while pairs is None:
            pairs = _pairing(rng, agents, each)
        return pairs

    return connected(agents, seed, draw, f"choose a degree above {each}")


def _pairing(rng: np.random.Generator, agents: Sequence[int], degree: int) -> list[tuple[int, int]] | None:
    """Join pairs of agents that need neighbours until none does; return None if no pair is left that may be joined."""
    missing = dict.fromkeys(agents, degree)
    pairs: set[tuple[int, int]] = set()
    while any(missing.values()):
        free = [(i, j) for i in agents for j in agents if i < j and missing[i] and missing[j] and (i, j) not in pairs]
        if not free:
            return None
        odds = np.array([missing[i] * missing[j] for i, j in free], dtype=np.float64)
        i, j = free[rng.choice(len(free), p=odds / odds.sum())]
        pairs.add((i, j))
        missing[i] -= 1
        missing[j] -= 1
    return sorted(pairs)
