"""``operator.json`` of a run directory: all that an operator needs to reach the agents, and nothing else.

It is written once, when a run starts. So a fleet can be stopped although its fleet file is damaged or its plug-ins
cannot be imported, and without the time that these take.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcf_zenoh.errors import RecordingError

if TYPE_CHECKING:
    from dcf_zenoh.messaging.address import Address

NAME = "operator.json"


@dataclass(frozen=True)
class OperatorFile:
    """Content of the file.

    Attributes:
        fleet: Name of the fleet.
        prefix: Start of all keys, ``dcf/<fleet>/<run>``.
        agents: Ids of the agents.
        settings: Complete Zenoh configuration of an operator's session: keys as paths, with their values.
    """

    fleet: str
    prefix: str
    agents: tuple[int, ...]
    settings: Mapping[str, Any]

    @classmethod
    def of(cls, fleet: str, agents: tuple[int, ...], address: "Address") -> "OperatorFile":
        """Return the file for a fleet whose agents are reached at `address`."""
        return cls(fleet, address.prefix, agents, address.entries())

    @classmethod
    def read(cls, folder: Path) -> "OperatorFile | None":
        """Read the file of a run directory; None if there is none that can be read."""
        try:
            content = json.loads((folder / NAME).read_text(encoding="utf-8"))
            agents = tuple(map(int, content["agents"]))
            return cls(str(content["fleet"]), str(content["prefix"]), agents, dict(content["settings"]))
        except (OSError, ValueError, TypeError, LookupError):
            return None

    def write(self, folder: Path) -> None:
        """Write the file in one step: several agents may write the same file at the same time.

        Raises:
            RecordingError: It cannot be written.
        """
        temporary = folder / f".{NAME}.{os.getpid()}"
        try:
            temporary.write_text(json.dumps(asdict(self), indent=2) + "\n", encoding="utf-8")
            temporary.replace(folder / NAME)
        except OSError as error:
            raise RecordingError(f"{folder / NAME}: cannot be written: {error.strerror}") from error
