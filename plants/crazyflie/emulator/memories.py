"""Memories of the drone that clients read and write."""

import errno
import struct
from collections.abc import Sequence
from typing import ClassVar, Protocol

from plants.crazyflie.emulator.crtp import MEMORY, Packet

INFORMATION, READ, WRITE = 0, 1, 2  # channels
COUNT, DETAILS = 1, 2


class Memory(Protocol):
    """Memory of a drone.

    Attributes:
        kind: Type, as clients know it.
        size: Size, bytes.
    """

    kind: ClassVar[int]
    size: ClassVar[int]

    def read(self, address: int, length: int) -> bytes:
        """Return `length` bytes from `address` on, which are within the memory."""

    def write(self, address: int, data: bytes) -> None:
        """Write bytes from `address` on, which are within the memory."""


class TestMemory:
    """Memory for tests of the transfer: each byte is the lowest of its address, whatever is written."""

    __test__ = False
    kind: ClassVar[int] = 0x15
    size: ClassVar[int] = 0x1000

    def read(self, address: int, length: int) -> bytes:
        """Return the lowest bytes of the addresses."""
        return bytes(each & 0xFF for each in range(address, address + length))

    def write(self, address: int, data: bytes) -> None:
        """Ignore what is written."""


class TrajectoryMemory:
    """Memory for trajectories, empty after power-on.

    Attributes:
        content: Its bytes.
    """

    kind: ClassVar[int] = 0x12
    size: ClassVar[int] = 0x1000

    def __init__(self) -> None:
        self.content = bytearray(self.size)

    def read(self, address: int, length: int) -> bytes:
        """Return stored bytes."""
        return bytes(self.content[address : address + length])

    def write(self, address: int, data: bytes) -> None:
        """Store bytes."""
        self.content[address : address + len(data)] = data


class Memories:
    """Service through which clients find, read and write memories.

    Args:
        memories: The memories, in the order of their numbers.
    """

    def __init__(self, memories: Sequence[Memory]) -> None:
        self._memories = memories

    def receive(self, channel: int, data: bytes) -> list[Packet]:
        """Handle a packet on the port of memories; return the answers."""
        if channel == INFORMATION:
            return self._information(data)
        error, read = self._access(channel, data)
        return [Packet(MEMORY, channel, data[:5] + bytes((error,)) + read)]

    def _information(self, data: bytes) -> list[Packet]:
        if data[0] == COUNT:
            return [Packet(MEMORY, INFORMATION, bytes((COUNT, len(self._memories))))]
        if data[0] == DETAILS and data[1] < len(self._memories):
            memory = self._memories[data[1]]
            return [Packet(MEMORY, INFORMATION, struct.pack("<BBBI8x", DETAILS, data[1], memory.kind, memory.size))]
        return [Packet(MEMORY, INFORMATION, data[:2])]

    def _access(self, channel: int, data: bytes) -> tuple[int, bytes]:
        """Read or write; return the error number, 0 for success, and the bytes read."""
        number, address = struct.unpack("<BI", data[:5])
        written = data[5:] if channel == WRITE else b""
        length = data[5] if channel == READ else len(written)
        if number >= len(self._memories) or channel not in (READ, WRITE):
            return errno.ENOENT, b""
        memory = self._memories[number]
        if address + length > memory.size:
            return errno.EIO, b""
        if channel == WRITE:
            memory.write(address, written)
            return 0, b""
        return 0, memory.read(address, length)
