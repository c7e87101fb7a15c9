"""The directory of a sweep: the plan of the sweep, and one file for every finished run."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import dcf_zenoh
from agentd.run_directory import new_folder
from agentd.sweeps.variants import Variant
from dcf_zenoh.config import LoadedFleet, freeze
from dcf_zenoh.errors import RecordingError

PLAN = "sweep.json"
Row = dict[str, Any]


class Task(NamedTuple):
    """One run of a sweep.

    Attributes:
        number: Number of the variant, from 1.
        variant: Variant of the fleet.
        seed: Seed of the fleet.
    """

    number: int
    variant: Variant
    seed: int

    @property
    def name(self) -> str:
        """Name of the run's files."""
        return f"{self.number:03}-seed-{self.seed}"


class SweepFolder:
    """The record of a sweep, with which an interrupted sweep can be continued.

    Attributes:
        path: Path of the directory.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def open(cls, out: Path | None, plan: Mapping[str, Any]) -> "SweepFolder":
        """Open the directory of the sweep with this plan.

        Args:
            out: Directory of the sweep if it was begun before, or a directory to begin it in; None for a new one.
            plan: Plan of the sweep, see `plan_of`.

        Raises:
            RecordingError: `out` holds something else, or cannot be written or read.
        """
        if out is not None and (out / PLAN).is_file():
            recorded = _read(out / PLAN)
            if recorded is None:
                raise RecordingError(f"{out / PLAN}: cannot be read; choose another directory with --out")
            other = next((key for key in {**plan, **recorded} if plan.get(key) != recorded.get(key)), None)
            if other is not None:
                why = _difference(other, recorded, plan)
                raise RecordingError(f"{out}: another sweep is in it ({why}); choose another directory with --out")
            return cls(out)
        folder = cls(new_folder(f"sweep-{plan['name']}", out))
        folder._write(folder.path / PLAN, plan)
        return folder

    def read_row(self, task: Task) -> Row | None:
        """Return the row of a run; None if the run is not finished."""
        return _read(self._file(task))

    def write_row(self, task: Task, row: Row) -> None:
        """Record the row of a finished run atomically.

        Raises:
            RecordingError: It cannot be written.
        """
        self._write(self._file(task), row)

    def run_folder(self, task: Task) -> Path:
        """Return the run directory of a run that is kept."""
        return self.path / "runs" / task.name

    def _file(self, task: Task) -> Path:
        return self.path / "rows" / f"{task.name}.json"

    @staticmethod
    def _write(file: Path, content: Mapping[str, Any]) -> None:
        temporary = file.with_name(f".{file.name}")
        try:
            file.parent.mkdir(exist_ok=True)
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
            temporary.replace(file)
        except OSError as error:
            raise RecordingError(f"{file}: cannot be written: {error.strerror}") from error


def plan_of(variants: Sequence[Variant], fleets: Sequence[LoadedFleet], *, seeds: Sequence[int], oracle: bool) -> Row:
    """Return the plan of a sweep: everything that its table depends on.

    Args:
        variants: Variants of the sweep.
        fleets: Fleet of each variant.
        seeds: Seeds of each variant.
        oracle: Whether decisions are compared with those of a central solver.
    """
    return {
        "name": fleets[0].spec.name,
        "version": dcf_zenoh.__version__,
        "vary": [variant.name for variant in variants],
        "seeds": list(seeds),
        "oracle": oracle,
        "fleets": [_fingerprint(fleet) for fleet in fleets],
    }


def _fingerprint(fleet: LoadedFleet) -> str:
    """Return the SHA-256 of the resolved fleet file and the plug-ins that it names."""
    with TemporaryDirectory() as folder:
        freeze(fleet, Path(folder))
        files = [Path(folder) / name for name in ("fleet.toml", "plugins.json")]
        return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def _difference(key: str, recorded: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Describe how two plans differ in `key`."""
    if key == "fleets":
        return "the fleet file, a plug-in, or what --set and other options say is not the same"
    if key == "vary":
        return "what it varies is not the same"
    return f"its {key}: {json.dumps(recorded.get(key))}, not {json.dumps(wanted.get(key))}"


def _read(file: Path) -> Row | None:
    """Read a JSON object; return None if there is no file, or no complete object in it."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None
