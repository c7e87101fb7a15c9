"""Random graphs, drawn again until one is connected."""

from collections.abc import Callable, Sequence

import numpy as np

from dcf_zenoh.errors import TopologyError
from dcf_zenoh.graph import Graph

DRAWS = 1000
Pairs = list[tuple[int, int]]


def connected(agents: Sequence[int], seed: int, draw: Callable[[np.random.Generator], Pairs], hint: str) -> Pairs:
    """Return the links, in both directions, of the first drawn graph that is connected.

    Args:
        agents: Ids, ascending.
        seed: Seed of the random numbers.
        draw: Function from a random generator to pairs of neighbours.
        hint: Advice for the message: what makes a connected graph more likely.

    Raises:
        TopologyError: None of `DRAWS` graphs is connected.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    for _ in range(DRAWS):
        pairs = draw(rng)
        links = [link for i, j in pairs for link in ((i, j), (j, i))]
        if len(Graph.of(agents, links).distances(agents[0])) == len(agents):
            return links
    raise TopologyError(f"none of {DRAWS} graphs that were drawn is connected; {hint}")
