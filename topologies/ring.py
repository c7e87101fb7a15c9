"""Ring graph."""

from collections.abc import Sequence


def ring(agents: Sequence[int], *, directed: bool = False) -> list[tuple[int, int]]:
    """Each agent and the next one, in order of ids, hear each other; the last and the first too.

    Args:
        agents: Ids, ascending.
        directed: The next agent hears an agent, which does not hear the next one.

    Returns:
        Links (sender, receiver).
    """
    following = [*agents[1:], *agents[:1]]
    links = [(i, j) for i, j in zip(agents, following, strict=True) if i != j]
    return links if directed else [*links, *((j, i) for i, j in links)]
