"""Star graph."""

from collections.abc import Sequence


def star(agents: Sequence[int], *, hub: int | None = None) -> list[tuple[int, int]]:
    """One agent and each other agent hear each other; there are no more links.

    Args:
        agents: Ids, ascending.
        hub: The agent in the middle; None: the lowest id.

    Returns:
        Links (sender, receiver).

    Raises:
        ValueError: There is no agent `hub`.
    """
    middle = min(agents) if hub is None else hub
    if middle not in agents:
        raise ValueError(f"hub must be one of the agents {list(agents)}, not {middle}")
    return [link for j in agents if j != middle for link in ((middle, j), (j, middle))]
