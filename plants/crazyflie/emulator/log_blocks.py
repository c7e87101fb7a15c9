"""Log of the firmware: blocks of variables that the drone sends periodically."""

import errno
import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

from plants.crazyflie.emulator.crtp import LOG, Packet
from plants.crazyflie.emulator.tables import Toc, TocEntry

TABLE, CONTROL, DATA = 0, 1, 2  # channels
DELETE, START, STOP, RESET, CREATE, APPEND = 2, 3, 4, 5, 6, 7
BLOCKS_MAX, VARIABLES_MAX, BYTES_MAX = 16, 128, 26
UNIT = 10  # ms; unit of a block's period
CODES = {"B": 1, "H": 2, "I": 3, "b": 4, "h": 5, "i": 6, "f": 7, "e": 8}
LAYOUTS = {code: layout for layout, code in CODES.items()}


class Variable(NamedTuple):
    """Variable of the log.

    Attributes:
        name: Name as 'group.name'.
        layout: Storage format, a letter of `struct` among `CODES`.
        value: Function that returns the present value.
    """

    name: str
    layout: str
    value: Callable[[], float]


class Block:
    """Variables that are sent together, and their period."""

    def __init__(self) -> None:
        self.fetched: list[tuple[Variable, str]] = []  # with the format requested by the client
        self.period = 0  # ms; 0 while stopped
        self.due = 0  # ms

    @property
    def size(self) -> int:
        """Size of the values, in bytes."""
        return struct.calcsize("<" + "".join(layout for _, layout in self.fetched))

    def values(self) -> bytes:
        """Return all present values, packed in the requested formats."""
        return b"".join(_packed(layout, variable.value()) for variable, layout in self.fetched)


class LogBlocks:
    """Logging service of the firmware.

    Args:
        variables: All variables of the log.
    """

    def __init__(self, variables: Sequence[Variable]) -> None:
        self._variables = variables
        entries = [TocEntry(v.name, CODES[v.layout]) for v in variables]
        self._table = Toc(LOG, entries, bytes((BLOCKS_MAX, VARIABLES_MAX)))
        self._blocks: dict[int, Block] = {}

    def receive(self, channel: int, data: bytes, now: int) -> list[Packet]:
        """Handle a packet received at `now`, ms; return the answers."""
        if channel == TABLE:
            return self._table.answer(data)
        if channel != CONTROL:
            return []
        if data[0] == RESET:
            self._blocks.clear()
            return [Packet(LOG, CONTROL, bytes((RESET, 0, 0)))]
        error = self._change(data[0], data[1], data[2:], now)
        return [Packet(LOG, CONTROL, bytes((data[0], data[1], error)))]

    def due(self, now: int) -> list[Packet]:
        """Return one packet for each block that is due at `now`, ms."""
        packets = []
        for number, block in self._blocks.items():
            if block.period and now >= block.due:
                block.due += block.period * (1 + (now - block.due) // block.period)
                head = struct.pack("<BI", number, now & 0xFFFFFF)[:4]
                packets.append(Packet(LOG, DATA, head + block.values()))
        return packets

    def _change(self, command: int, number: int, rest: bytes, now: int) -> int:
        """Execute a command on one block; return its error number, 0 for success."""
        if command == CREATE:
            return self._create(number, rest)
        block = self._blocks.get(number)
        if block is None:
            return errno.ENOENT
        if command == APPEND:
            return self._append(block, rest)
        if command == DELETE:
            del self._blocks[number]
        elif command in (START, STOP):
            block.period = UNIT * rest[0] if command == START else 0
            block.due = now + block.period
        else:
            return errno.ENOEXEC
        return 0

    def _create(self, number: int, rest: bytes) -> int:
        if number in self._blocks:
            return errno.EEXIST
        if len(self._blocks) >= BLOCKS_MAX:
            return errno.ENOMEM
        block = Block()
        error = self._append(block, rest)
        if not error:
            self._blocks[number] = block
        return error

    def _append(self, block: Block, rest: bytes) -> int:
        wanted = []
        for kind, number in struct.iter_unpack("<BH", rest):
            if number >= len(self._variables) or kind & 0x0F not in LAYOUTS:
                return errno.ENOENT
            wanted.append((self._variables[number], LAYOUTS[kind & 0x0F]))
        if sum(len(each.fetched) for each in self._blocks.values()) + len(wanted) > VARIABLES_MAX:
            return errno.ENOMEM
        before = list(block.fetched)
        block.fetched += wanted
        if block.size > BYTES_MAX:
            block.fetched = before
            return errno.E2BIG
        return 0


def _packed(layout: str, value: float) -> bytes:
    """Pack a value; whole numbers wrap around, as in C."""
    if layout in "fe":
        return struct.pack("<" + layout, value)
    size = struct.calcsize(layout)
    return (int(value) % (1 << 8 * size)).to_bytes(size, "little")
