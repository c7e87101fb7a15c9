"""Random graphs that are connected: drawn again until they are."""

from collections.abc import Callable, Sequence

import numpy as np

from dcf_zenoh.errors import TopologyError
from dcf_zenoh.graph import Graph

DRAWS = 1000
Pairs = list[tuple[int, int]]


def connected(agents: Sequence[int], seed: int, draw: Callable[[np.random.Generator], Pairs], hint: str) -> Pairs:
    """The links of the first graph drawn that is connected, in both directions.

    Args:
        agents: Ids, ascending.
        seed: Of the random numbers.
        draw: Pairs of neighbours, from random numbers; others in each call.
        hint: What would make it more likely to be connected.

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
