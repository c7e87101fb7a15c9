"""Two rooms, one radio link between them."""


def barbell(agents, *, bridge: tuple[int, int] | None = None):
    """All links within each half of the agents, and one link in both directions between the halves.

    Args:
        agents: Ids, ascending.
        bridge: Ids of its two ends, one of each half; by default the last of the first half and the first of the second.
    """
    half = (len(agents) + 1) // 2
    rooms = agents[:half], agents[half:]
    links = [(i, j) for room in rooms for i in room for j in room if i != j]
    if rooms[1]:
        here, there = bridge or (rooms[0][-1], rooms[1][0])
        if here not in rooms[0] or there not in rooms[1]:
            raise ValueError(f"bridge must join {list(rooms[0])} with {list(rooms[1])}, not {here} with {there}")
        links += [(here, there), (there, here)]
    return links
