"""Runs whose links do something known."""

from pathlib import Path

import dcf_zenoh
from dcf_zenoh import Run
from tests.support.lossy_fleets import lossy

# Loses what is named, and doubles or delays what is named: lists of [step, round].
NAMED = '''
from dcf_zenoh.faults.fault import Fault, Stage

class Named(Fault):
    """Does something to single messages."""
    def __init__(self, *, lost: list[list[int]] = [], doubled: list[list[int]] = [],
                 delayed: list[list[int]] = [], by: float = 0.0):
        self.lost, self.doubled, self.delayed, self.by = lost, doubled, delayed, round(by * 1e9)
    def apply(self, delivery, rng):
        place = [delivery.message.step, delivery.message.round]
        if place in self.lost:
            return ()
        if place in self.delayed:
            delivery = delivery._replace(due=delivery.due + self.by)
        return (delivery, delivery) if place in self.doubled else (delivery,)
'''


def named(folder: Path, rules: str, *changes: str, topology: str = "complete", out: Path | None = None) -> Run:
    """Ten steps of four point masses; in `rules`, ``"./named.py:Named"`` is a kind of fault."""
    (folder / "named.py").write_text(NAMED, encoding="utf-8")
    fleet = lossy(folder, rules, topology)
    return dcf_zenoh.simulate(fleet, changes=["time.duration=2.0", *changes], out=out)
