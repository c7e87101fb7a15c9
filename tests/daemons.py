"""Fleets of real daemons, launched in processes of their own, watched and always cleaned up."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from dcf_zenoh.recording import log_name
from dcf_zenoh.run import AgentLog

# Three agents that change places and never say that they have arrived. {} takes more tables.
SWAP = """
name = "trio"
plant = "point"

[time]
clock = "wall"
duration = 60.0

[problem]
kind = "position_swap"

[algorithm]
kind = "trades"

[plants.point]
kind = "point_mass"

[agents.1]
start = [0.0, 1.0]
target = [0.0, -1.0]

[agents.2]
start = [0.0, -1.0]
target = [0.0, 1.0]

[agents.3]
start = [1.0, 0.0]
target = [-1.0, 0.0]
"""


def until(true: Callable[[], bool], what: str, within: float = 30.0) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + within
    tick = time.monotonic()
    while not true():
        assert time.monotonic() < deadline, f"not within {within:g} s: {what}"
        tick += 0.005
        os.sched_yield()
        while time.monotonic() < tick:
            _pause(tick - time.monotonic())


def _pause(seconds: float) -> None:
    """Leave the processor to others."""
    if seconds > 0:
        signal.sigtimedwait([], seconds)
