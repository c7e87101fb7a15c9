"""What comes of reading a fleet file."""

from dataclasses import dataclass
from pathlib import Path

from dcf_zenoh.spec import FleetSpec


@dataclass(frozen=True)
class LoadedFleet:
    """A fleet file, checked.

    Attributes:
        spec: The fleet.
        folder: What the paths of plug-ins are relative to.
        source: The file.
        notes: What the user should know, one line each.
    """

    spec: FleetSpec
    folder: Path
    source: str
    notes: tuple[str, ...] = ()
