"""A file of plug-ins."""

BLIMP = """
from __future__ import annotations
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal
import numpy as np
import numpy.typing as npt
from pydantic import Field
if TYPE_CHECKING:
    from nowhere import Start

class Blimp:
    def __init__(
        self, start: Start, agent: int, *,
        mass: Annotated[float, Field(gt=0)], drag: npt.NDArray[np.float64] | None = None,
        box: tuple[float, float] = (1.0, 1.0), mode: Literal["float", "sink"] = "float", names: list[str] = [],
        gain=0.5, count=3, quiet=False, sizes=(1, 2), free=None,
    ) -> None:
        self.given = (start, agent, mass, drag, box, mode, names, gain, count, quiet, sizes, free)
        if mass > 100:
            raise ValueError("mass must be at most 100 kg, not %g" % mass)
        if mass > 50:
            raise KeyError("oops")

class Odd:
    def __init__(self, altitude): pass

def tracking(problem, me, *, step=0.05, relax: float = 0.6, dual: float): yield

def short(problem): yield

@dataclass
class Data:
    size: int = 3

number = 3
"""
