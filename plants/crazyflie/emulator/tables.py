"""Tables of contents: names and types of log variables and parameters, for clients to download."""

import struct
import zlib
from collections.abc import Sequence
from typing import NamedTuple

from plants.crazyflie.emulator.crtp import Packet

ITEM, INFO = 2, 3  # requests on the channel of the table


class TocEntry(NamedTuple):
    """Entry of a table.

    Attributes:
        name: Name as 'group.name'.
        code: Type code of the table; for parameters including their properties.
    """

    name: str
    code: int


class Toc:
    """Table of contents, which answers requests.

    Args:
        port: Port of the requests.
        entries: Entries in the order of their numbers.
        extra: Bytes after the checksum in the answer about the table as a whole.
    """

    def __init__(self, port: int, entries: Sequence[TocEntry], extra: bytes = b"") -> None:
        self._port = port
        self._items = [bytes((e.code,)) + e.name.replace(".", "\0").encode() + b"\0" for e in entries]
        self._info = struct.pack("<HI", len(entries), zlib.crc32(bytes((port,)) + b"".join(self._items))) + extra
        self._numbers = {e.name: number for number, e in enumerate(entries)}

    def number(self, name: str) -> int | None:
        """Return the number of the entry 'group.name'; None if there is none."""
        return self._numbers.get(name)

    def answer(self, data: bytes) -> list[Packet]:
        """Answer a request: one packet, or none for an unknown request."""
        if data[0] == INFO:
            return [Packet(self._port, 0, data[:1] + self._info)]
        if data[0] == ITEM:
            (number,) = struct.unpack("<H", data[1:3])
            item = self._items[number] if number < len(self._items) else b""
            return [Packet(self._port, 0, data[:3] + item)]
        return []
