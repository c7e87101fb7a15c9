"""A fleet file with third-party plug-ins next to it, to be changed by tests."""

from pathlib import Path
from typing import Any

import pytest

from dcf_zenoh.config import Overrides, load
from dcf_zenoh.errors import ConfigurationError

FLEET = """
name = "test"

[time]
sample_time = 0.2

[topology]
kind = "ring"

[problem]
kind = "./mine.py:Meet"
radius = 0.5

[algorithm]
kind = "./mine.py:descend"
step = 0.1

[algorithms.fine]
kind = "./mine.py:descend"
relax = 0.5

[plants.point_mass]
accel_max = 1

[agents.1]
start = [0.0, 1.0]
target = [0.0, -1.0]

[agents.2]
start = [0.0, -1.0]
target = [0.0, 1.0]
plants.point_mass.accel_max = 2.5

[agents.3]
start = [1.0, 0.0]
target = [-1.0, 0.0]
problem.radius = 1
"""

MINE = """
class Meet:
    def __init__(self, agent, agents, sample_time, *, target: tuple[float, ...], radius: float = 1.0, sides: int = 3):
        raise AssertionError("nothing is constructed")

def descend(problem, me, *, step: float = 0.05, relax: float = 1.0):
    yield

def spokes(agents, *, hub: int):
    for j in agents:
        if j != hub:
            yield hub, j

class Blimp:
    def __init__(self, start, *, mass: float = 1.0): pass
"""


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def problems(source: Path | str, *changes: str, run_plugins: bool = True, **choices: Any) -> list[str]:
    """What loading finds wrong, without the file's name."""
    with pytest.raises(ConfigurationError) as caught:
        load(source, Overrides(**choices), changes=changes, run_plugins=run_plugins)
    assert caught.value.source == str(source)
    assert str(caught.value).splitlines() == [f"{source}: {problem}" for problem in caught.value.problems]
    return list(caught.value.problems)
