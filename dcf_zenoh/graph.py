"""Directed communication graphs, an agent's neighbourhood in one, and weight matrices."""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dcf_zenoh.errors import TopologyError
from dcf_zenoh.plant import Array


@dataclass(frozen=True)
class Graph:
    """Directed graph of agents. A link (i, j) carries messages from i to j. `Graph.of` makes one from any iterables.

    Attributes:
        agents: Ids of the agents, ascending.
        links: Pairs (sender, receiver); no agent has a link to itself.
    """

    agents: tuple[int, ...]
    links: frozenset[tuple[int, int]]

    @classmethod
    def of(cls, agents: Iterable[int], links: Iterable[Sequence[int]]) -> "Graph":
        """Return the graph of `agents` and `links`, each a pair (sender, receiver).

        Raises:
            TopologyError: A link is not a pair, names an agent that does not exist, or joins an agent to itself.
        """
        ids = tuple(sorted(agents))
        known = set(ids)
        pairs = set()
        for link in links:
            try:
                sender, receiver = link
            except (TypeError, ValueError):
                raise TopologyError(f"a link is a pair (sender, receiver), not {link!r}") from None
            for end in (sender, receiver):
                if end not in known:
                    raise TopologyError(f"link {sender} -> {receiver}: there is no agent {end}; agents are {list(ids)}")
            if sender == receiver:
                raise TopologyError(f"link {sender} -> {receiver}: an agent needs no link to itself")
            pairs.add((sender, receiver))
        return cls(ids, frozenset(pairs))

    def in_neighbours(self, agent: int) -> tuple[int, ...]:
        """Return the agents from which `agent` receives, ascending."""
        return self._neighbours[0][agent]

    def out_neighbours(self, agent: int) -> tuple[int, ...]:
        """Return the agents to which `agent` sends, ascending."""
        return self._neighbours[1][agent]

    @cached_property
    def _neighbours(self) -> tuple[dict[int, tuple[int, ...]], dict[int, tuple[int, ...]]]:
        """Agent -> in-neighbours, and agent -> out-neighbours."""
        senders: dict[int, list[int]] = {agent: [] for agent in self.agents}
        receivers: dict[int, list[int]] = {agent: [] for agent in self.agents}
        for i, j in sorted(self.links):
            senders[j].append(i)
            receivers[i].append(j)
        return {i: tuple(js) for i, js in senders.items()}, {i: tuple(js) for i, js in receivers.items()}

    @cached_property
    def undirected(self) -> bool:
        """Whether every link has its opposite."""
        return all((j, i) in self.links for i, j in self.links)

    def distances(self, source: int) -> dict[int, int]:
        """Return agent -> hops from `source`, for every agent that a message from it can reach; 0 for itself."""
        found = {source: 0}
        queue = deque([source])
        while queue:
            here = queue.popleft()
            for there in self.out_neighbours(here):
                if there not in found:
                    found[there] = found[here] + 1
                    queue.append(there)
        return found

    @cached_property
    def diameter(self) -> int:
        """Largest number of hops between two agents.

        Raises:
            TopologyError: The graph is not strongly connected; the message names a pair without a path.
        """
        longest = 0
        for source in self.agents:
            hops = self.distances(source)
            for agent in self.agents:
                if agent not in hops:
                    kind = "connected" if self.undirected else "strongly connected"
                    raise TopologyError(
                        f"the graph is not {kind}: nothing agent {source} sends can reach agent {agent}"
                    )
            longest = max(longest, *hops.values())
        return longest


@dataclass(frozen=True)
class Neighbourhood:
    """One agent's part of the graph.

    Attributes:
        receives_from: In-neighbours, ascending.
        sends_to: Out-neighbours, ascending.
        weights: Row of the weight matrix: in-neighbour or the agent itself -> weight, ascending by id, sum 1.
        diameter: Diameter of the whole graph, in hops; 0 for a lone agent.
        doubly_stochastic: Whether the columns of the weight matrix sum to 1 too, so that mixing keeps the mean.
    """

    receives_from: tuple[int, ...]
    sends_to: tuple[int, ...]
    weights: dict[int, float]
    diameter: int
    doubly_stochastic: bool

    @classmethod
    def of(cls, graph: Graph, agent: int, weights: Array) -> "Neighbourhood":
        """Return the part of `agent`, given the graph and its weight matrix (rows and columns in order of ids)."""
        row = weights[graph.agents.index(agent)]
        senders = graph.in_neighbours(agent)
        return cls(
            receives_from=senders,
            sends_to=graph.out_neighbours(agent),
            weights={j: float(row[graph.agents.index(j)]) for j in sorted((agent, *senders))},
            diameter=graph.diameter,
            doubly_stochastic=bool(np.allclose(weights.sum(axis=0), 1.0, rtol=0.0, atol=1e-12)),
        )


def metropolis(graph: Graph) -> Array:
    """Return Metropolis weights w_ij = 1 / (1 + max(d_i, d_j)), w_ii = 1 - sum_j w_ij. Doubly stochastic.

    Source: Xiao, Boyd, Lall, "Distributed average consensus with time-varying Metropolis weights", 2006.

    Raises:
        TopologyError: The graph has a link without its opposite.
    """
    _check_undirected(graph, "Metropolis")
    degree = {agent: len(graph.in_neighbours(agent)) for agent in graph.agents}
    return _symmetric(graph, lambda i, j: 1.0 / (1.0 + max(degree[i], degree[j])))


def laplacian(graph: Graph, step: float | None = None) -> Array:
    """Return equal weights for all neighbours: W = I - step L with the graph's Laplacian L. Doubly stochastic.

    Source: Olfati-Saber, Fax, Murray, "Consensus and cooperation in networked multi-agent systems", 2007, eq. (19).

    Args:
        graph: Undirected graph.
        step: Weight of each neighbour, less than 1 / d with d the largest number of neighbours; None: 1 / (1 + d).

    Raises:
        TopologyError: The graph has a link without its opposite, or the step is too large.
    """
    _check_undirected(graph, "Laplacian")
    most = max(len(graph.in_neighbours(agent)) for agent in graph.agents)
    weight = 1.0 / (1.0 + most) if step is None else step
    if not 0 < weight * most < 1 and most:
        raise TopologyError(
            f"weight_step must be less than 1 / {most}, as there is an agent with {most} neighbours, not {weight:g}"
        )
    return _symmetric(graph, lambda _i, _j: weight)


def _check_undirected(graph: Graph, weights: str) -> None:
    if not graph.undirected:
        i, j = min(link for link in graph.links if link[::-1] not in graph.links)
        raise TopologyError(
            f"{weights} weights need an undirected graph, and link {i} -> {j} has no opposite; use weights = 'uniform'"
        )


def _symmetric(graph: Graph, weight: Callable[[int, int], float]) -> Array:
    """Return the matrix with the given weights of pairs of neighbours; each agent keeps the rest of its row."""
    column = {agent: place for place, agent in enumerate(graph.agents)}
    matrix = np.zeros((len(graph.agents), len(graph.agents)))
    for row, i in enumerate(graph.agents):
        for j in graph.in_neighbours(i):
            matrix[row, column[j]] = weight(i, j)
        matrix[row, row] = 1.0 - matrix[row].sum()
    return matrix


def uniform(graph: Graph) -> Array:
    """Return equal weights 1 / (1 + in-degree) for an agent and its in-neighbours. Row-stochastic on any graph."""
    return _by_rows(graph, lambda _row, degree: (1.0 / (1 + degree), 1.0 / (1 + degree)))


def uneven(graph: Graph) -> Array:
    """Return weights that are row-stochastic on any graph and doubly stochastic on almost none.

    Agent number k = 1, 2, ... in order of ids keeps k / (k + 1) for itself and divides the rest evenly among its
    in-neighbours. Not even a directed ring keeps the mean, which tests what an algorithm does then.
    """
    return _by_rows(
        graph, lambda row, degree: ((row + 1) / (row + 2), 1.0 / (row + 2) / degree) if degree else (1.0, 0.0)
    )


def _by_rows(graph: Graph, weights: Callable[[int, int], tuple[float, float]]) -> Array:
    """Return the matrix whose rows `weights` defines: row, in-degree -> own weight, weight of each in-neighbour."""
    column = {agent: place for place, agent in enumerate(graph.agents)}
    matrix = np.zeros((len(graph.agents), len(graph.agents)))
    for row, i in enumerate(graph.agents):
        senders = graph.in_neighbours(i)
        matrix[row, row], other = weights(row, len(senders))
        for j in senders:
            matrix[row, column[j]] = other
    return matrix


WEIGHTS: dict[str, Callable[[Graph], Array]] = {
    "metropolis": metropolis,
    "laplacian": laplacian,
    "uniform": uniform,
    "uneven": uneven,
}
