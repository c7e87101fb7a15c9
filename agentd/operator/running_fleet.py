"""Where a run is: its directory, its fleet, where its agents listen, and whether it is over."""

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
from dcf_zenoh.messaging.network import Address
from dcf_zenoh.records.agent_log import AgentLog, has_log

RUNS = Path("runs")


@dataclass(frozen=True)
class RunningFleet:
    """A run, as its directory tells.

    Attributes:
        folder: The run directory.
        fleet: The resolved fleet.
        about: What the launcher has noted; nothing if there was none.
    """

    folder: Path
    fleet: LoadedFleet
    about: Mapping[str, Any]

    @classmethod
    def read(cls, folder: Path) -> "RunningFleet":
        """Read a run directory.

        Raises:
            ConfigurationError: Its fleet file cannot be read.
            RecordingError: What the launcher has noted cannot be read.
        """
        return cls(folder, load(folder / "fleet.toml"), read_run_json(folder))

    @property
    def logs(self) -> dict[int, AgentLog]:
        """Id -> what the agent has recorded so far, of those whose logs are here and can be read."""
        return self._read[0]

    @property
    def unreadable(self) -> dict[int, str]:
        """Id -> why its log, which is here, cannot be read."""
        return self._read[1]

    @cached_property
    def _read(self) -> tuple[dict[int, AgentLog], dict[int, str]]:
        logs: dict[int, AgentLog] = {}
        problems: dict[int, str] = {}
        for i in (i for i in self.fleet.spec.ids if has_log(self.folder, i)):
            try:
                logs[i] = AgentLog.load(self.folder, i, self.fleet.spec)
            except RecordingError as error:
                problems[i] = str(error)
        return logs, problems

    @cached_property
    def over(self) -> bool:
        """Whether all agents have ended, as far as is known here."""
        if self.about.get("endpoints"):
            return "ended" in self.about
        return len(self.logs) == len(self.fleet.spec.ids) and all(log.end for log in self.logs.values())

    @property
    def address(self) -> Address:
        """Where an operator reaches the agents."""
        spec = self.fleet.spec
        run = self.about.get("run") or next(
            (str(log.header["run"]) for log in self.logs.values() if "run" in log.header), "manual"
        )
        endpoints = self.about.get("endpoints") or default_endpoints(spec)
        return Address(f"dcf/{spec.name}/{run}", "", tuple(map(str, endpoints.values())), spec.zenoh.settings)


def find_run(name: str) -> Path:
    """The run directory `name`, or the newest below ``runs`` of the fleet of that name.

    Raises:
        RecordingError: There is neither.
    """
    folder = Path(name)
    if (folder / "fleet.toml").is_file():
        return folder
    fleets: dict[str, tuple[int, Path]] = {}
    for path in RUNS.glob("*/fleet.toml"):
        found = _fleet_name(path), path.stat().st_mtime_ns, path.parent
        fleets[found[0]] = max(fleets.get(found[0], (0, path.parent)), found[1:])
    if name in fleets:
        return fleets[name][1]
    if folder.is_dir():
        raise RecordingError(f"{folder}: not a run directory: it has no fleet.toml")
    raise RecordingError(
        f"{name}: no run directory, and no run of a fleet of this name below {RUNS}/{nearest(name, fleets)}"
        f" fleets that have run there: {listed(sorted(fleets))}"
    )


def _fleet_name(path: Path) -> str:
    try:
        return str(tomllib.loads(path.read_text(encoding="utf-8")).get("name", ""))
    except (OSError, ValueError):  # somebody else's file
        return ""
