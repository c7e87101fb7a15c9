"""Grid graph."""

from collections.abc import Sequence
from math import isqrt


def grid(agents: Sequence[int], *, rows: int | None = None, columns: int | None = None) -> list[tuple[int, int]]:
    """Agents fill a grid row by row, in order of ids; agents next to each other in a row or column hear each other.

    Args:
        agents: Ids, ascending.
        rows: Number of rows. None: it follows from `columns`; without either, the grid is as square as possible.
        columns: Number of columns, likewise.

    Returns:
        Links (sender, receiver).

    Raises:
        ValueError: `rows` times `columns` is not the number of agents.
    """
    count = len(agents)
    if rows is None and columns is None:
        rows = next(each for each in range(isqrt(count), 0, -1) if count % each == 0)
    for name, size in (("rows", rows), ("columns", columns)):
        if size is not None and (size < 1 or count % size):
            allowed = [each for each in range(1, count + 1) if count % each == 0]
            raise ValueError(f"{name} must divide the {count} agents, so be one of {allowed}, not {size}")
    if rows is None:
        rows = count // (columns or 1)
    if columns is None:
        columns = count // rows
    if rows * columns != count:
        raise ValueError(
            f"rows x columns must be {count}, the number of agents, not {rows} x {columns} = {rows * columns}"
        )
    beside = [(i, i + 1) for i in range(count) if (i + 1) % columns]
    below = [(i, i + columns) for i in range(count - columns)]
    pairs = [(agents[i], agents[j]) for i, j in beside + below]
    return pairs + [(j, i) for i, j in pairs]
