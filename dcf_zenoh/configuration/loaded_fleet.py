"""The result of reading a fleet file."""

from dataclasses import dataclass
from pathlib import Path

from dcf_zenoh.spec import FleetSpec


@dataclass(frozen=True)
class LoadedFleet:
    """A checked fleet file.

    Attributes:
        spec: Specification of the fleet.
        folder: Folder that paths of plug-ins are relative to.
        source: Path of the file, for messages.
        notes: Remarks for the user about what is permitted but may surprise, one line each.
    """

    spec: FleetSpec
    folder: Path
    source: str
    notes: tuple[str, ...] = ()
