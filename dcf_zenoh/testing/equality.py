"""Comparison of payloads."""

from collections.abc import Mapping
from typing import Any

import numpy as np


def same_payload(before: Any, after: Any) -> bool:
    """Return whether two payloads, or two entries of payloads (arrays, numbers, payloads per neighbour), are equal."""
    if isinstance(before, Mapping):
        return before.keys() == after.keys() and all(same_payload(value, after[name]) for name, value in before.items())
    return np.array_equal(before, after, equal_nan=True)
