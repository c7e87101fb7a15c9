"""Waiting for what other threads and processes do."""

import time
from collections.abc import Callable


def until(true: Callable[[], object], what: str, within: float = 30.0) -> float:
    """Wait until `true` returns something true; return the seconds that it took.

    A look that is expensive is repeated less often, so that waiting leaves the machine to the fleet.
    """
    began = looked = time.monotonic()
    while not true():
        now = time.monotonic()
        assert now - began < within, f"not so within {within:g} s: {what}"
        time.sleep(min(0.05, max(0.005, 2 * (now - looked))))  # between two looks
        looked = time.monotonic()
    return time.monotonic() - began
