"""Parameters of the firmware: named values that a client can read and set."""

import errno
import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

from plants.crazyflie.emulator.crtp import PARAM, Packet
from plants.crazyflie.emulator.tables import Toc, TocEntry

TABLE, READ, WRITE, MISCELLANEOUS = 0, 1, 2, 3  # channels
SET_BY_NAME, EXTENDED_TYPE, DEFAULT_VALUE = 0, 7, 8  # requests on the last one
CODES = {"b": 0, "h": 1, "i": 2, "f": 6, "B": 8, "H": 9, "I": 10}
READ_ONLY = 0x40


def no_effect(value: float) -> None:
    """Ignore the value: most parameters have no effect."""


class FirmwareParameter(NamedTuple):
    """Parameter of the firmware.

    Attributes:
        name: Name as 'group.name'.
        layout: Storage format, a letter of `struct` among `CODES`.
        default: Value after power-on.
        fixed: The parameter is read-only.
        changed: Called with each value that is set.
    """

    name: str
    layout: str
    default: float
    fixed: bool = False
    changed: Callable[[float], None] = no_effect


class Parameters:
    """Parameter service of the firmware.

    Args:
        parameters: All parameters.
    """

    def __init__(self, parameters: Sequence[FirmwareParameter]) -> None:
        self._parameters = parameters
        entries = [TocEntry(p.name, CODES[p.layout] | READ_ONLY * p.fixed) for p in parameters]
        self._table = Toc(PARAM, entries)
        self._values = [p.default for p in parameters]

    def __getitem__(self, name: str) -> float:
        """Return the value of 'group.name'."""
        return self._values[self._number(name)]

    def reset(self, name: str) -> None:
        """Set a parameter to its default, without calling its function."""
        number = self._number(name)
        self._values[number] = self._parameters[number].default

    def receive(self, channel: int, data: bytes) -> list[Packet]:
        """Handle a packet; return the answers."""
        if channel == TABLE:
            return self._table.answer(data)
        if channel == MISCELLANEOUS:
            return self._miscellaneous(data)
        (number,) = struct.unpack("<H", data[:2])
        if number >= len(self._parameters):
            return [Packet(PARAM, channel, data[:2] + bytes((errno.ENOENT,)))]
        if channel == READ:
            return [Packet(PARAM, READ, data[:2] + b"\0" + self._packed(number))]
        self._set(number, data[2:])
        return [Packet(PARAM, WRITE, data[:2] + self._packed(number))]

    def is_last(self, channel: int, data: bytes) -> bool:
        """Return whether a packet requests the value of the last parameter, which ends a client's connecting."""
        return channel == READ and data[:2] == struct.pack("<H", len(self._parameters) - 1)

    def _number(self, name: str) -> int:
        number = self._table.number(name)
        if number is None:
            raise KeyError(name)
        return number

    def _miscellaneous(self, data: bytes) -> list[Packet]:
        if data[0] == SET_BY_NAME:
            group, name, value = data[1:].split(b"\0", 2)
            number = self._table.number(f"{group.decode()}.{name.decode()}")
            error = errno.ENOENT if number is None else 0
            if number is not None:
                self._set(number, value[1:])  # after its type
            return [Packet(PARAM, MISCELLANEOUS, data[:1] + group + b"\0" + name + b"\0" + bytes((error,)))]
        (number,) = struct.unpack("<H", data[1:3])
        if data[0] == DEFAULT_VALUE and number < len(self._parameters):
            parameter = self._parameters[number]
            value = struct.pack("<" + parameter.layout, _stored(parameter.layout, parameter.default))
            return [Packet(PARAM, MISCELLANEOUS, data[:3] + b"\0" + value)]
        return [
            Packet(PARAM, MISCELLANEOUS, data[:3] + bytes((errno.ENOENT,)))
        ]  # no parameter is stored over a restart

    def _set(self, number: int, value: bytes) -> None:
        parameter = self._parameters[number]
        if not parameter.fixed:
            (new,) = struct.unpack("<" + parameter.layout, value)
            self._values[number] = new
            parameter.changed(new)

    def _packed(self, number: int) -> bytes:
        layout = self._parameters[number].layout
        return struct.pack("<" + layout, _stored(layout, self._values[number]))


def _stored(layout: str, value: float) -> float | int:
    return value if layout == "f" else int(value)
