"""The directory of a run, and where its agents listen."""

import json
import os
import random
import socket
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from dcf_zenoh.errors import NetworkError, RecordingError
from dcf_zenoh.records.writer import log_name
from dcf_zenoh.spec import FleetSpec

PORTS = range(20000, 32000)  # below what systems give to outgoing connections


def new_run_folder(fleet: FleetSpec, out: Path | None) -> Path:
    """An empty run directory: `out`, or a new one below ``runs``.

    Raises:
        RecordingError: It cannot be made, or has something in it.
    """
    folder = new_folder(fleet.name, out)
    try:
        write_about(folder, {})
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be written: {error.strerror}") from error
    return folder


def new_folder(name: str, out: Path | None) -> Path:
    """An empty directory: `out`, or a new one below ``runs`` for `name`.

    Raises:
        RecordingError: It cannot be made, or has something in it.
    """
    folder = out or Path("runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S}-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise RecordingError(f"{folder}: this directory is not empty; choose another with --out")
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be written: {error.strerror}") from error
    return folder


def check_unused(folder: Path, agent: int) -> None:
    """Refuse to touch a directory in which the agent has run before.

    Raises:
        RecordingError: Its log is there.
    """
    path = folder / log_name(agent)
    if path.exists():
        raise RecordingError(f"{path}: there is a log already; choose another directory with --out")


def write_about(folder: Path, about: Mapping[str, Any]) -> None:
    """Replace ``run.json`` in one step."""
    temporary = folder / ".run.json"
    temporary.write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    temporary.replace(folder / "run.json")


def read_about(folder: Path) -> dict[str, Any]:
    """What ``run.json`` says; nothing if there is none.

    Raises:
        RecordingError: It is not JSON, or says something else.
    """
    path = folder / "run.json"
    try:
        found: Any = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    if not isinstance(found, dict) or not isinstance(found.get("endpoints", {}), dict):
        raise RecordingError(f"{path}: cannot be read: expected an object, in which 'endpoints' is one too")
    return found


def free_endpoints(fleet: FleetSpec) -> dict[int, str]:
    """Where every agent listens: as the fleet file says, or a free port of the loopback interface.

    Raises:
        NetworkError: There are not enough free ports.
    """
    given = {i: fleet.agents[i].endpoint for i in fleet.ids}
    ports = filter(_is_free, random.sample(PORTS, len(PORTS)))
    candidates = (endpoint for port in ports if (endpoint := f"tcp/127.0.0.1:{port}") not in given.values())
    try:
        return {i: endpoint or next(candidates) for i, endpoint in given.items()}
    except StopIteration:
        raise NetworkError(f"no free port on the loopback interface between {PORTS.start} and {PORTS.stop}") from None


def default_endpoints(fleet: FleetSpec) -> dict[int, str]:
    """Where agents listen when nobody launched them together."""
    return {i: fleet.agents[i].endpoint or f"tcp/127.0.0.1:{fleet.zenoh.base_port + i}" for i in fleet.ids}


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
