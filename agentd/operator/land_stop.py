"""``agentd land`` and ``agentd stop``: end the flight of a running fleet.

They import neither the fleet's plug-ins nor numpy, and read one small file (`agentd.operator_file`).
"""

import json
import sys
from pathlib import Path
from typing import Literal

from agentd import exit_codes
from agentd.daemon.end_requests import LAND, STOP, error_in
from agentd.operator.session import print_complaints, send_queries
from agentd.operator_file import NAME, OperatorFile
from dcf_zenoh.errors import ConfigurationError, DcfError

TIMEOUT = 3.0  # s for the answers of all agents
TIMEOUT_ENDED = 1.0  # s, if the launcher has noted that the run has ended
RUNS = Path("runs")
RUNS_MAX = 4  # runs of a fleet that are asked


def main(how: Literal["land", "stop"], name: str) -> int:
    """Run the command; return its exit code."""
    try:
        return end_flight(name, how)
    except DcfError as error:
        for line in str(error).splitlines():
            print(f"agentd: {line}", file=sys.stderr)
        return exit_codes.of(error)


def end_flight(name: str, how: Literal["land", "stop"]) -> int:
    """Make all agents of a run land or stop their motors; return the exit code, 1 if an agent does not answer.

    A fleet that seems to have ended is tried, too: nothing but the silence of all agents shows that it has.

    Args:
        name: Run directory, or name of a fleet.
        how: Whether to land or to stop all motors at once.

    Raises:
        ConfigurationError: The run is over.
        RecordingError: There is no such run.
        NetworkError: Zenoh cannot be opened.
    """
    request = STOP if how == "stop" else LAND
    runs = _find(name)
    for folder, fleet in runs:
        ended = _ended(folder)
        timeout = TIMEOUT_ENDED if ended else TIMEOUT
        replies = send_queries(fleet.prefix, fleet.settings, dict.fromkeys(fleet.agents, request), timeout)
        if replies:
            break
    else:
        folder, fleet = runs[0]
        if _ended(folder):
            raise ConfigurationError("this run is over", str(folder))
    complaints = []
    for agent in fleet.agents:
        if agent not in replies:
            complaints.append(f"agent {agent} did not answer within {timeout:g} s")
        elif error := error_in(replies[agent]):
            complaints += [f"agent {agent}: {line}" for line in error.splitlines()]
        else:
            print(f"agent {agent}: {'lands' if how == 'land' else 'motors off'}")
    return print_complaints(complaints)


def _find(name: str) -> list[tuple[Path, OperatorFile]]:
    """Return the directory and the operator's file of a run directory, or of the runs of a fleet that may fly.

    Of a fleet these are the newest `RUNS_MAX` runs whose end no launcher has noted, newest first; if there is none, the
    newest run.

    Raises:
        RecordingError: There is no such run.
    """
    if found := OperatorFile.read(Path(name)):
        return [(Path(name), found)]
    if not Path(name).is_dir():
        paths = sorted(RUNS.glob(f"*/{NAME}"), key=lambda path: path.stat().st_mtime_ns, reverse=True)
        runs = [(each.parent, found) for each in paths if (found := OperatorFile.read(each.parent))]
        named = [(folder, file) for folder, file in runs if file.fleet == name]
        if named:
            return [each for each in named if not _ended(each[0])][:RUNS_MAX] or named[:1]
    from agentd.operator.running_fleet import RunningFleet, find_run  # noqa: PLC0415 - imports all that a fleet needs

    run = RunningFleet.read(find_run(name))  # of an earlier version
    return [(run.folder, OperatorFile.of(run.fleet.spec.name, run.fleet.spec.ids, run.address))]


def _ended(folder: Path) -> bool:
    """Return whether a launcher has noted that the run has ended."""
    try:
        return "ended" in json.loads((folder / "run.json").read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError):
        return False
