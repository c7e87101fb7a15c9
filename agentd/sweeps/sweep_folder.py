"""The directory of a sweep: what is swept, and one file for every run that is finished."""

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
        number: Of the variant, from 1.
        variant: The variant.
        seed: The seed.
    """

    number: int
    variant: Variant
    seed: int

    @property
    def name(self) -> str:
        """What its files are called."""
        return f"{self.number:03}-seed-{self.seed}"


class SweepFolder:
    """Where a sweep is recorded; an interrupted one goes on where it was left.

    Attributes:
        path: The directory.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def open(cls, out: Path | None, plan: Mapping[str, Any]) -> "SweepFolder":
        """The directory of the sweep that `plan` describes: a new one, or `out` if that sweep was begun there.

        Raises:
            RecordingError: There is something else in it, or it cannot be written or read.
        """
        if out is not None and (out / PLAN).is_file():
            there = _read(out / PLAN)
            if there is None:
                raise RecordingError(f"{out / PLAN}: cannot be read; choose another directory with --out")
            other = next((key for key in {**plan, **there} if plan.get(key) != there.get(key)), None)
            if other is not None:
                why = _contrast(other, there, plan)
                raise RecordingError(f"{out}: another sweep is in it ({why}); choose another directory with --out")
            return cls(out)
        folder = cls(new_folder(f"sweep-{plan['name']}", out))
        folder._write(folder.path / PLAN, plan)
        return folder

    def row(self, task: Task) -> Row | None:
        """What came of a run; None if it has not been finished."""
        return _read(self._file(task))

    def keep(self, task: Task, row: Row) -> None:
        """Write down what came of a run, whole or not at all.

        Raises:
            RecordingError: It cannot be written.
        """
        self._write(self._file(task), row)

    def run(self, task: Task) -> Path:
        """The directory of a run that is kept."""
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


def plan_of(variants: Sequence[Variant], fleets: Sequence[LoadedFleet], **more: Any) -> Row:
    """What makes a sweep what it is: the variants, what a run of each depends on, and whatever else is given."""
    return {
        "name": fleets[0].spec.name,
        "version": dcf_zenoh.__version__,
        "vary": [variant.name for variant in variants],
        **more,
        "fleets": [_fingerprint(fleet) for fleet in fleets],
    }


def _fingerprint(fleet: LoadedFleet) -> str:
    """SHA-256 over the resolved fleet file and the plug-ins that it names."""
    with TemporaryDirectory() as folder:
        freeze(fleet, Path(folder))
        files = [Path(folder) / name for name in ("fleet.toml", "plugins.json")]
        return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def _contrast(key: str, there: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """In what two sweeps differ."""
    if key == "fleets":
        return "the fleet file, a plug-in, or what --set and other options say is not the same"
    if key == "vary":
        return "what it varies is not the same"
    return f"its {key}: {json.dumps(there.get(key))}, not {json.dumps(wanted.get(key))}"


def _read(file: Path) -> Row | None:
    """A JSON object; None if there is none, or not a whole one."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None
