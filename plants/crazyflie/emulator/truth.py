"""Ground truth of a drone's flight, for tests: a file of JSON lines, written during the flight."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO

SAMPLE = 20  # ms between two recorded states


class Truth:
    """Recorder of one drone. Each record has a kind and a time, s, of the drone's own clock.

    "state": position, m; velocity, m/s; angles: roll, pitch (positive nose down), yaw, rad; motors, 0 .. 1; estimate of
    the position, m; state of the supervisor. "command": a client's command, see `Ports`. "event": see `Firmware`,
    `Drone`.

    Args:
        path: Path of the file; None: nothing is recorded.
    """

    def __init__(self, path: Path | None) -> None:
        self._file: TextIO | None = None
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("w", encoding="utf-8")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()

    @property
    def kept(self) -> bool:
        """Whether records are written."""
        return self._file is not None

    def write(self, kind: str, now: int, **fields: Any) -> None:
        """Write a record at `now`, ms, and flush it to the file."""
        if self._file is not None:
            self._file.write(json.dumps({"kind": kind, "time": now / 1000, **fields}) + "\n")
            self._file.flush()


@dataclass(frozen=True, slots=True)
class Record:
    """Record of the truth.

    Attributes:
        kind: "state", "command" or "event".
        time: Time of the drone's clock, s.
        fields: Other fields, by name.
    """

    kind: str
    time: float
    fields: Mapping[str, Any]

    def __getitem__(self, name: str) -> Any:
        """Return one of the fields."""
        return self.fields[name]


def read_truth(path: Path) -> list[Record]:
    """Read all complete records that the file has so far."""
    lines = path.read_text(encoding="utf-8").split("\n")[:-1] if path.is_file() else []
    records = []
    for line in lines:
        fields = json.loads(line)
        records.append(Record(fields.pop("kind"), fields.pop("time"), fields))
    return records


def rounded(values: Iterable[float], digits: int = 4) -> list[float]:
    """Round numbers for a file."""
    return [round(float(value), digits) for value in values]
