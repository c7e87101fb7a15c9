"""Whether something changed that must not."""

from collections.abc import Mapping
from typing import Any

import numpy as np


def same_payload(before: Any, after: Any) -> bool:
    """Whether two payloads are equal, or two entries of them: arrays, numbers, or the payloads of edges."""
    if isinstance(before, Mapping):
        return before.keys() == after.keys() and all(same_payload(value, after[name]) for name, value in before.items())
    return np.array_equal(before, after, equal_nan=True)
