"""Random graph with independent links."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from topologies.random_links import connected


def erdos_renyi(agents: Sequence[int], *, probability: float = 0.5, seed: int = 0) -> list[tuple[int, int]]:
    """Each pair of agents hears each other with the same probability; drawn again until the graph is connected.

    Args:
        agents: Ids, ascending.
        probability: Probability that two agents are linked, in (0, 1].
        seed: Seed of the random numbers.

    Returns:
        Links (sender, receiver).

    Raises:
        ValueError: `probability` is out of its range.
        TopologyError: No connected graph was found: `probability` is too small.

    Source: Gilbert, "Random graphs", Annals of Mathematical Statistics, 1959; Erdős and Rényi, "On random graphs I",
    Publicationes Mathematicae, 1959.
    """
    if not 0 < probability <= 1:
        raise ValueError(f"probability must be in (0, 1], not {probability}")
    pairs = list(combinations(agents, 2))

    def draw(rng: np.random.Generator) -> list[tuple[int, int]]:
        return [pair for pair, number in zip(pairs, rng.random(len(pairs)), strict=True) if number < probability]

    return connected(agents, seed, draw, f"choose a probability above {probability:g}")
