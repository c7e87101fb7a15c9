"""What a topology must satisfy, built-in or anybody's."""

from collections.abc import Callable, Iterable, Sequence

from dcf_zenoh.graph import Graph


def check_topology(topology: Callable[[tuple[int, ...]], Iterable[Sequence[int]]], *counts: int) -> None:
    """The contract of a topology: pairs of different agents among those that there are, connected, the same again.

    Args:
        topology: Options bound.
        counts: Numbers of agents to try it with; without any, 1 to 8.

    Raises:
        TopologyError: A pair is none, names an agent that is not there, or there is no way from one agent to another.
        AssertionError: It breaks the contract in another way; the message says how.
    """
    for count in counts or range(1, 9):
        agents = tuple(3 * place + 2 for place in range(count))  # ids are any numbers
        links = [tuple(link) for link in topology(agents)]
        assert [tuple(link) for link in topology(agents)] == links, f"{count} agents: it is not repeatable"
        assert Graph.of(agents, links).diameter < count
