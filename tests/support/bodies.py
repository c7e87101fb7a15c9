"""A fleet whose bodies write down what they are told, and fail where they shall."""

from pathlib import Path

import dcf_zenoh
from dcf_zenoh.records.run import Run
from tests.support.small_fleet import small_fleet

BODY = """\
import json
from pathlib import Path
from dcf_zenoh.plant import Check, State
from plants.point_mass import PointMass


class Body(PointMass):
    landing_time = 1.0

    def __init__(self, agent, start, *, diary: str, fails: str = "", pauses: int = 0, lands_in: int = 0):
        super().__init__(start)
        self.agent, self.fails, self.pauses, self.lands_in = agent, fails, pauses, lands_in
        self.diary = Path(diary)

    def note(self, what):
        with self.diary.open("a") as diary:
            diary.write(f"{self.agent} {what}\\n")
        if what in self.fails.split(","):
            raise RuntimeError("no")

    def phase(self, what, pauses=None):
        self.note(what)
        for _ in range(self.pauses if pauses is None else pauses):
            yield 0.1

    def prepare(self): return self.phase("prepare")
    def inspect(self): return self.phase("inspect")
    def arm(self): return self.phase("arm")
    def take_off(self): return self.phase("take_off")
    def settle(self): return self.phase("settle")
    def go_to_start(self): return self.phase("go_to_start")

    def checks(self):
        low = "at least 3.5 V is needed" if self.fails == "checks" else ""
        return Check("battery", "3.92 V", low), Check("heading", "1 deg")

    def start(self, now):
        self.note(f"start {now}")

    def finish(self, now, reason):
        return self.phase(f"finish {reason}", self.lands_in)

    def emergency_stop(self):
        self.note("emergency")

    def close(self):
        self.note("close")
"""
PHASES = ["prepare", "inspect", "arm", "take_off", "settle", "go_to_start"]


class Sandbox:
    """A fleet of three on a path, and the diary of its bodies."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "phases.toml"
        self.diary = folder / "diary"
        (folder / "body.py").write_text(BODY)

    def write(self, duration: float) -> None:
        """Write the fleet file."""
        text = small_fleet(
            "phases",
            plant=None,
            time={"clock": "virtual", "duration": duration},
            topology={"kind": "path"},
            plants={"body": {"kind": "./body.py:Body", "diary": str(self.diary)}},
        )
        self.file.write_text(text)

    def fly(self, *changes: str, duration: float = 1.0) -> Run:
        """Fly in the simulator."""
        self.write(duration)
        return dcf_zenoh.simulate(self.file, changes=changes)

    @property
    def entries(self) -> list[tuple[int, str]]:
        """Agent and what it was told, in order."""
        text = self.diary.read_text() if self.diary.exists() else ""
        lines = [line.split(" ", 1) for line in text.splitlines()]
        return [(int(agent), what) for agent, what in lines]

    def of(self, agent: int) -> list[str]:
        """What one agent was told, in order."""
        return [what for i, what in self.entries if i == agent]
