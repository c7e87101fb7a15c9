"""A running fleet as its run directory describes it: specification, endpoints, logs, and whether the run is over."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from agentd.endpoints import default_endpoints
from agentd.run_directory import read_run_json
from dcf_zenoh.config import LoadedFleet, load
from dcf_zenoh.diagnostics import listed, nearest
from dcf_zenoh.errors import RecordingError
from dcf_zenoh.messaging.address import Address, prefix_of
from dcf_zenoh.records.agent_log import AgentLog, has_log

RUNS = Path("runs")


@dataclass(frozen=True)
class RunningFleet:
    """A run that may still be under way.

    Attributes:
        folder: Run directory.
        fleet: Fleet of the run.
        run_json: Content of ``run.json``, written by a launcher; empty if the daemons were started by hand.
    """

    folder: Path
    fleet: LoadedFleet
    run_json: Mapping[str, Any]

    @classmethod
    def read(cls, folder: Path) -> "RunningFleet":
        """Read a run directory.

        Raises:
            ConfigurationError: Its fleet file cannot be read.
            RecordingError: Its ``run.json`` cannot be read.
        """
        return cls(folder, load(folder / "fleet.toml"), read_run_json(folder))

    @property
    def logs(self) -> dict[int, AgentLog]:
        """Id -> log so far of the agent, for the agents whose logs are in the directory and can be read."""
        return self._read[0]

    @property
    def unreadable(self) -> dict[int, str]:
        """Id -> why the log of the agent, which is in the directory, cannot be read."""
        return self._read[1]

    @cached_property
    def _read(self) -> tuple[dict[int, AgentLog], dict[int, str]]:
        logs: dict[int, AgentLog] = {}
        unreadable: dict[int, str] = {}
        for i in (i for i in self.fleet.spec.ids if has_log(self.folder, i)):
            try:
                logs[i] = AgentLog.load(self.folder, i, self.fleet.spec)
            except RecordingError as error:
                unreadable[i] = str(error)
        return logs, unreadable

    @cached_property
    def over(self) -> bool:
        """Whether all agents have ended, as far as the directory shows.

        An agent that was started again by hand may fly on after its launcher has ended.
        """
        if self.run_json.get("endpoints"):
            flying = any(log.lives > 1 and log.end is None for log in self.logs.values())
            return "ended" in self.run_json and not flying
        return len(self.logs) == len(self.fleet.spec.ids) and all(log.end for log in self.logs.values())

    @property
    def address(self) -> Address:
        """Keys and endpoints at which an operator reaches the agents."""
        spec = self.fleet.spec
        run = self.run_json.get("run") or next(
            (str(log.header["run"]) for log in self.logs.values() if "run" in log.header), "manual"
        )
        endpoints = self.run_json.get("endpoints") or default_endpoints(spec)
        return Address(prefix_of(spec.name, run), "", tuple(map(str, endpoints.values())), spec.zenoh.settings)


def find_run(name: str) -> Path:
    """Return the run directory `name`, or else the newest run below ``runs`` of the fleet `name`.

    Raises:
        RecordingError: There is neither.
    """
    folder = Path(name)
    if (folder / "fleet.toml").is_file():
        return folder
    newest: dict[str, tuple[int, Path]] = {}  # fleet -> time at which its newest run was made, and its directory
    for path in RUNS.glob("*/fleet.toml"):
        fleet, run = _fleet_name(path), (path.stat().st_mtime_ns, path.parent)
        newest[fleet] = max(newest.get(fleet, run), run)
    if name in newest:
        return newest[name][1]
    if folder.is_dir():
        raise RecordingError(f"{folder}: not a run directory: it has no fleet.toml")
    raise RecordingError(
        f"{name}: no run directory, and no run of a fleet of this name below {RUNS}/{nearest(name, newest)}"
        f" fleets that have run there: {listed(sorted(newest))}"
    )


def _fleet_name(path: Path) -> str:
    try:
        return str(tomllib.loads(path.read_text(encoding="utf-8")).get("name", ""))
    except (OSError, ValueError):  # not a fleet file of ours
        return ""
