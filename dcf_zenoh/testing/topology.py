"""Contract check for topologies."""

from collections.abc import Callable, Iterable, Sequence

from dcf_zenoh.graph import Graph


def check_topology(topology: Callable[[tuple[int, ...]], Iterable[Sequence[int]]], *counts: int) -> None:
    """Check the contract of a topology: pairs of different agents of the fleet, strongly connected, repeatable.

    Args:
        topology: Topology with its options bound.
        counts: Numbers of agents to try; without any, 1 to 8.

    Raises:
        TopologyError: A link is not a pair, names an agent that does not exist, or joins an agent to itself; or there
            is no path from one agent to another.
        AssertionError: The topology is not repeatable.
    """
    for count in counts or range(1, 9):
        agents = tuple(3 * place + 2 for place in range(count))  # ids are any numbers
        links = [tuple(link) for link in topology(agents)]
        assert [tuple(link) for link in topology(agents)] == links, f"{count} agents: it is not repeatable"
        assert Graph.of(agents, links).diameter < count
