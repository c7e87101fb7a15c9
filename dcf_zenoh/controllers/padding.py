"""Stacking of states that differ in length (bodies in the plane and in space) as the rows of one array."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.plant import Array


def stacked(values: Sequence[Array]) -> Array:
    """Return 1-D arrays as the rows of one array; shorter ones are padded with NaN at the end."""
    longest = max(map(len, values))
    if all(len(value) == longest for value in values):
        return np.array(values)
    return np.array([np.pad(value, (0, longest - len(value)), constant_values=np.nan) for value in values])


def unstacked(row: Array) -> Array:
    """Return a row of `stacked` without its padding."""
    return row[: np.flatnonzero(~np.isnan(row))[-1] + 1] if np.isnan(row[-1]) else row
