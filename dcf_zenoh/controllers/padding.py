"""States of unlike bodies, in the plane and in space, as the rows of one array."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.plant import Array


def stacked(values: Sequence[Array]) -> Array:
    """Arrays as the rows of one; if they differ in length, shorter ones end in NaN."""
    longest = max(map(len, values))
    if all(len(value) == longest for value in values):
        return np.array(values)
    return np.array([np.pad(value, (0, longest - len(value)), constant_values=np.nan) for value in values])


def unstacked(row: Array) -> Array:
    """A row as it was before it was stacked."""
    return row[: np.flatnonzero(~np.isnan(row))[-1] + 1] if np.isnan(row[-1]) else row
