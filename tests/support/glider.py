"""A problem, a plant and a fault with sub-tables, for tests of nested options."""

GLIDER = '''
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar
from pydantic import Field
from dcf_zenoh.faults.fault import Fault, Stage

@dataclass(frozen=True)
class Inner:
    gain: float = 1.0
    names: tuple[str, ...] = ("a",)

@dataclass(frozen=True)
class Weights:
    """How much each part of the cost counts."""
    SCALE: ClassVar[float] = 2.0
    state: tuple[float, float] = (1.0, 0.1)
    input: Annotated[float, Field(gt=0)] = 1.0
    inner: Inner = Inner()
    unit: float | None = None
    total: float = field(init=False, default=0.0)

    def __post_init__(self):
        if self.input > sum(self.state) * 10:
            raise ValueError(f"input must be at most ten times the sum of state, not {self.input:g}")

@dataclass(frozen=True)
class Range:
    low: float
    high: float = 9.0

@dataclass(frozen=True)
class Noise:
    seed: int = 3

class Glide:
    SHARED = ("limits", "weights.state")
    RENAMED = {"input": "weights.input", "limits": "limits.low"}

    def __init__(self, agent, *, target: tuple[float, ...] = (0.0, 0.0), weights: Weights = Weights(input=0.5),
                 limits: "Range", noise: Noise | None = None, free: dict = {}):
        self.weights, self.limits, self.noise = weights, limits, noise

class Glider:
    def __init__(self, start, *, weights: Weights = Weights()): pass

class Fog(Fault):
    STAGE = Stage.LOSS

    def __init__(self, *, probability: float = 0.5, limits: Range = Range(1.0)): pass

    def apply(self, delivery, rng): return (delivery,)

def solve(problem, me, *, weights: Weights = Weights()):
    yield

def loose(agents, *, weights: "Loose"):
    return []

@dataclass
class Loose:
    x: float = 1.0

def broken(agents, *, weights: "Broken"):
    return []

@dataclass(frozen=True)
class Broken:
    x: "Missing" = 1.0
'''

GLIDERS = """
name = "gliders"

[problem]
kind = "./glider.py:Glide"
weights = { input = 2.0 }

[problem.limits]
low = -1.0

[algorithm]
kind = "./glider.py:solve"

[plants.glider]
kind = "./glider.py:Glider"
weights = { state = [2.0, 0.2] }

[agents.1]
start = [0.0, 1.0]
problem = { weights = { input = 3.0 } }

[agents.2]
start = [0.0, -1.0]
plants.glider.weights.input = 4.0
"""
