"""One in the middle."""

from collections.abc import Sequence


def star(agents: Sequence[int], *, hub: int | None = None) -> list[tuple[int, int]]:
    """One agent and each of the others hear each other; the others do not.

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
