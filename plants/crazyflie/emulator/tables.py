"""Tables of contents: the named variables and parameters that a client can ask for."""

import struct
import zlib
from collections.abc import Sequence
from typing import NamedTuple

from plants.crazyflie.emulator.crtp import Packet

ITEM, INFO = 2, 3  # requests on the channel of the table


class TocEntry(NamedTuple):
    """One line of a table.

    Attributes:
        name: 'group.name'.
        code: Type, and for parameters its properties, as this table writes them.
    """

    name: str
    code: int


class Toc:
    """A table of contents, and the answers to questions about it.

    Args:
        port: Of the packets that ask for it.
        entries: In the order of their numbers.
        extra: What follows the checksum in the answer about the table as a whole.
    """

    def __init__(self, port: int, entries: Sequence[TocEntry], extra: bytes = b"") -> None:
        self._port = port
        self._items = [bytes((e.code,)) + e.name.replace(".", "\0").encode() + b"\0" for e in entries]
        self._info = struct.pack("<HI", len(entries), zlib.crc32(bytes((port,)) + b"".join(self._items))) + extra
        self._numbers = {e.name: number for number, e in enumerate(entries)}

    def number(self, name: str) -> int | None:
        """The number of an entry, from 'group.name'; None if there is none."""
        return self._numbers.get(name)

    def answer(self, data: bytes) -> list[Packet]:
        """The answer to a question about the table: one packet, or none if it is not understood."""
        if data[0] == INFO:
            return [Packet(self._port, 0, data[:1] + self._info)]
        if data[0] == ITEM:
            (number,) = struct.unpack("<H", data[1:3])
            item = self._items[number] if number < len(self._items) else b""
            return [Packet(self._port, 0, data[:3] + item)]
        return []
