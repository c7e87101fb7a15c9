"""Random geometric graph: links between agents at nearby random places."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from topologies.random_links import connected


def geometric(agents: Sequence[int], *, radius: float = 0.5, seed: int = 0) -> list[tuple[int, int]]:
    """Agents at random places in a unit square hear each other within a radius; drawn again until connected.

    These places are independent of the positions of plants.

    Args:
        agents: Ids, ascending.
        radius: Largest distance of linked agents, positive; the square has side 1.
        seed: Seed of the random numbers.

    Returns:
        Links (sender, receiver).

    Raises:
        ValueError: `radius` is not positive.
        TopologyError: No connected graph was found: `radius` is too small.

    Source: Penrose, "Random geometric graphs", 2003.
    """
    if not radius > 0:
        raise ValueError(f"radius must be positive, not {radius}")

    def draw(rng: np.random.Generator) -> list[tuple[int, int]]:
        places = dict(zip(agents, rng.random((len(agents), 2)), strict=True))
        return [(i, j) for i, j in combinations(agents, 2) if np.hypot(*(places[i] - places[j])) <= radius]

    return connected(agents, seed, draw, f"choose a radius above {radius:g}")
