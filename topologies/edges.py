"""Graph given link by link."""

from collections.abc import Sequence

from dcf_zenoh.errors import TopologyError


def edges(agents: Sequence[int], *, links: list[tuple[int, int]], directed: bool = False) -> list[tuple[int, int]]:
    """Links given in a list.

    Args:
        agents: Ids, ascending.
        links: Pairs of ids.
        directed: A pair is one link, from the first agent to the second; otherwise it is a link in both directions.

    Returns:
        Links (sender, receiver).

    Raises:
        TopologyError: A link names an agent that is not there, or the same agent twice.
    """
    for i, j in links:
        if i not in agents or j not in agents or i == j:
            raise TopologyError(f"links must be pairs of different agents among {list(agents)}, not [{i}, {j}]")
    return [*links] if directed else [*links, *((j, i) for i, j in links)]
