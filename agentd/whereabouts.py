"""Where a run is: its directory, its fleet, where its agents listen, and whether it is over."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

from agentd.rundir import default_endpoints, read_about
from dcf_zenoh.agent_log import AgentLog
from dcf_zenoh.config import LoadedFleet, load
from dcf_zenoh.configuration.wording import listed, nearest
from dcf_zenoh.errors import RecordingError
from dcf_zenoh.messaging.network import Address
from dcf_zenoh.recording import log_name

RUNS = Path("runs")


@dataclass(frozen=True)
class Whereabouts:
    """A run, as its directory tells.

    Attributes:
        folder: The run directory.
        fleet: The resolved fleet.
        logs: Id -> what the agent has recorded so far, of those whose logs are here.
        address: Where an operator reaches the agents.
        over: Whether all agents have ended.
    """

    folder: Path
    fleet: LoadedFleet
    logs: dict[int, AgentLog]
    address: Address
    over: bool

    @classmethod
    def read(cls, folder: Path) -> "Whereabouts":
        """Read a run directory.

        Raises:
            RecordingError: It is none, or a log in it cannot be read.
            ConfigurationError: Its fleet file cannot be read.
        """
        fleet = load(folder / "fleet.toml")
        spec, about = fleet.spec, read_about(folder)
        paths = {i: folder / log_name(i) for i in spec.ids}
        logs = {
            i: AgentLog.read(data, str(path))
            for i, path in paths.items()
            if path.is_file() and (data := path.read_bytes())
        }
        run = about.get("run") or next((log.header["run"] for log in logs.values() if "run" in log.header), "manual")
        endpoints = about.get("endpoints") or default_endpoints(spec)
        address = Address(f"dcf/{spec.name}/{run}", "", tuple(map(str, endpoints.values())), spec.zenoh.settings)
        ended = len(logs) == len(spec.ids) and all(log.end for log in logs.values())
        return cls(folder, fleet, logs, address, over="ended" in about or ended)


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
