"""What a drone really did, for tests: a file of JSON lines that is written while it happens."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO

SAMPLE = 20  # ms between two states


class Truth:
    """Writes the records of one drone. Each has a kind and a time, s, which is the drone's own since it began.

    "state": position, m; velocity, m/s; angles: roll, pitch (positive nose down), yaw, rad; motors, 0 .. 1; estimate of
    the position, m; what the supervisor thinks. "command": what came from a client. "event": see `Firmware`, `Drone`.

    Args:
        path: The file; None: nothing is kept.
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
        """Whether anything is kept."""
        return self._file is not None

    def write(self, kind: str, now: int, **fields: Any) -> None:
        """One record at `now`, ms; at once in the file."""
        if self._file is not None:
            self._file.write(json.dumps({"kind": kind, "time": now / 1000, **fields}) + "\n")
            self._file.flush()


@dataclass(frozen=True, slots=True)
class Record:
    """One record of the truth.

    Attributes:
        kind: "state", "command" or "event".
        time: s.
        fields: What else is in it, by name.
    """

    kind: str
    time: float
    fields: Mapping[str, Any]

    def __getitem__(self, name: str) -> Any:
        """One of the fields."""
        return self.fields[name]


def read_truth(path: Path) -> list[Record]:
    """All complete records that are in the file so far."""
    lines = path.read_text(encoding="utf-8").split("\n")[:-1] if path.is_file() else []
    records = []
    for line in lines:
        fields = json.loads(line)
        records.append(Record(fields.pop("kind"), fields.pop("time"), fields))
    return records


def rounded(values: Iterable[float], digits: int = 4) -> list[float]:
    """Numbers short enough for a file."""
    return [round(float(value), digits) for value in values]
