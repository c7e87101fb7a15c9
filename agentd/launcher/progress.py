"""Progress of a launched fleet, on standard error."""

import time
from collections.abc import Mapping
from itertools import combinations
from math import dist
from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.live import Live
from rich.table import Table

from dcf_zenoh.spec import FleetSpec

LINE_PERIOD = 2.0  # s between lines where there is no terminal


class Progress:
    """Shows progress as a live table on a terminal, elsewhere as a line every `LINE_PERIOD`.

    Args:
        fleet: Specification of the fleet.
        quiet: Print messages only.
    """

    def __init__(self, fleet: FleetSpec, *, quiet: bool = False) -> None:
        self._fleet = fleet
        self._quiet = quiet
        self._console = Console(stderr=True)
        self._live: Live | None = None
        self._last_line = time.monotonic()
        self._phase = ""

    def __enter__(self) -> Self:
        if self._console.is_terminal and not self._quiet:
            self._live = Live(console=self._console, transient=True, auto_refresh=False)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def message(self, line: str) -> None:
        """Print a line above the live table."""
        self._console.print(f"agentd: {line}", style="bold red", markup=False, highlight=False, soft_wrap=True)

    def show(self, status: Mapping[int, Mapping[str, Any]]) -> None:
        """Show the progress of all agents.

        Args:
            status: Agent -> latest status; see `agentd.daemon.daemon.Status` for its keys.
        """
        if self._live is not None:
            self._live.update(self._table(status), refresh=True)
            return
        if self._quiet:
            return
        phases = {str(entry.get("phase", "")) for entry in status.values()}
        if len(phases) == 1 and phases != {self._phase}:
            (self._phase,) = phases
            if self._phase not in ("", "start"):
                self._console.print(f"all agents: {_phase_text(self._phase)}", markup=False, highlight=False)
        if time.monotonic() - self._last_line >= LINE_PERIOD:
            self._last_line = time.monotonic()
            steps = [entry.get("step", "-") for entry in status.values() if not entry.get("ended")] or ["-"]
            late = sum(entry.get("late", 0) for entry in status.values())
            line = f"step {min(map(str, steps), key=len)} of {self._fleet.steps}, {late} deadlines missed"
            self._console.print(line + self._separation(status), markup=False, highlight=False)

    def _table(self, status: Mapping[int, Mapping[str, Any]]) -> Table:
        table = Table(title=f"{self._fleet.name}{self._separation(status)}", title_justify="left")
        for heading in ("agent", "step", "rounds", "deadlines missed", "position, m", ""):
            table.add_column(heading, justify="right")
        for agent, entry in status.items():
            position = ", ".join(f"{value:+.2f}" for value in entry.get("position", ()))
            phase = str(entry.get("phase", ""))
            step = f"{entry['step'] + 1} / {self._fleet.steps}" if "step" in entry else _phase_text(phase)
            step = _phase_text(phase) if phase == "land" else step
            remark = str(entry.get("remark", ""))
            table.add_row(str(agent), step, str(entry.get("rounds", "")), str(entry.get("late", "")), position, remark)
        return table

    @staticmethod
    def _separation(status: Mapping[int, Mapping[str, Any]]) -> str:
        flying = [entry for entry in status.values() if not entry.get("ended")]
        positions = [entry["position"] for entry in flying if entry.get("position")]
        gaps = [dist(a, b) for a, b in combinations(positions, 2) if len(a) == len(b)]
        return f", closest pair {min(gaps):.2f} m" if gaps else ""


def _phase_text(phase: str) -> str:
    """Describe what agents do in a phase of the flight."""
    if phase == "land":
        return "landing"
    return f"getting ready: {phase.replace('_', ' ')}" if phase else "getting ready"
