"""The directory of a run: made empty, checked before use, described in ``run.json``."""

import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from dcf_zenoh.errors import RecordingError
from dcf_zenoh.spec import FleetSpec

_STARTED = (  # what is written before an agent's first record
    "run.json", "operator.json", "fleet.toml", "plugins.json", "sources.json", "plugins", "modules", "profiles"
)  # fmt: skip
_LOG, _ERRORS = re.compile(r"agent-[0-9]+\.msgpack"), re.compile(r"agent-[0-9]+\.err")


def new_run_folder(fleet: FleetSpec, out: Path | None) -> Path:
    """Make an empty run directory: `out`, or a new one below ``runs``.

    Raises:
        RecordingError: It cannot be made, or is not empty.
    """
    folder = new_folder(fleet.name, out)
    try:
        write_run_json(folder, {})
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be written: {error.strerror}") from error
    return folder


def new_folder(name: str, out: Path | None) -> Path:
    """Make an empty directory: `out`, or a new one below ``runs`` whose name begins with `name`.

    Raises:
        RecordingError: It cannot be made, or is not empty.
    """
    folder = out or Path("runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S}-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if _holds_only_a_start(folder):
            _clear(folder)
        if any(folder.iterdir()):
            raise RecordingError(f"{folder}: this directory is not empty; choose another with --out")
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be written: {error.strerror}") from error
    return folder


def _holds_only_a_start(folder: Path) -> bool:
    """Return whether a directory holds what a start that failed has left: files of ours, and no record of an agent."""
    entries = list(folder.iterdir())
    logs = {path for path in entries if _LOG.fullmatch(path.name)}
    ours = all(each in logs or each.name in _STARTED or _ERRORS.fullmatch(each.name) for each in entries)
    return ours and not any(path.stat().st_size for path in logs) and "ended" in read_run_json(folder)


def _clear(folder: Path) -> None:
    for each in folder.iterdir():
        if each.is_dir():
            shutil.rmtree(each)
        else:
            each.unlink()


@contextmanager
def followed(folder: Path) -> Iterator[Callable[[], Path]]:
    """Follow a directory that may be renamed meanwhile.

    Returns:
        Function that returns where the directory is now; `folder` itself if it was removed, or where the system has no
        /proc.
    """
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)

    def place() -> Path:
        try:
            if folder.is_dir() and os.path.samestat(folder.stat(), os.fstat(handle)):
                return folder
            now = Path(f"/proc/self/fd/{handle}").readlink()
        except OSError:
            return folder
        return now if now.is_dir() else folder

    try:
        yield place
    finally:
        os.close(handle)


def write_run_json(folder: Path, content: Mapping[str, Any]) -> None:
    """Replace ``run.json`` atomically."""
    temporary = folder / ".run.json"
    temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    temporary.replace(folder / "run.json")


def read_run_json(folder: Path) -> dict[str, Any]:
    """Read ``run.json``; return an empty dict if there is none.

    Raises:
        RecordingError: It is not JSON, or not an object whose ``endpoints``, if any, are an object.
    """
    path = folder / "run.json"
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    if not isinstance(content, dict) or not isinstance(content.get("endpoints", {}), dict):
        raise RecordingError(f"{path}: cannot be read: expected an object, in which 'endpoints' is one too")
    return content
