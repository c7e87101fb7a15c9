"""Parameters of the firmware: named values that a client can read and set."""

import errno
import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

from plants.crazyflie.emulator.crtp import PARAM, Packet
from plants.crazyflie.emulator.tables import Toc, TocEntry

TABLE, READ, WRITE, MISCELLANEOUS = 0, 1, 2, 3  # channels
SET_BY_NAME, STORE, GET_STATE, CLEAR, EXTENDED_TYPE, DEFAULT_VALUE = 0, 3, 4, 5, 7, 8  # requests on the last one
CODES = {"b": 0, "h": 1, "i": 2, "f": 6, "B": 8, "H": 9, "I": 10}
EXTENDED, CORE, READ_ONLY = 0x10, 0x20, 0x40  # bits of a type; core parameters stay from release to release
PERSISTENT = 1  # extended type


def _type_of(parameter: "FirmwareParameter") -> int:
    """Return the type of a parameter in the table."""
    bits = READ_ONLY * parameter.fixed | EXTENDED * parameter.persistent | CORE * parameter.core
    return CODES[parameter.layout] | bits


def no_effect(value: float) -> None:
    """Ignore the value: most parameters have no effect."""


class FirmwareParameter(NamedTuple):
    """Parameter of the firmware.

    Attributes:
        name: Name as 'group.name'.
        layout: Storage format, a letter of `struct` among `CODES`.
        default: Value after power-on.
        fixed: The parameter is read-only.
        persistent: Its value can be stored over a restart.
        core: It stays from release to release, as clients are told.
        changed: Called with each value that is set.
    """

    name: str
    layout: str
    default: float
    fixed: bool = False
    changed: Callable[[float], None] = no_effect
    persistent: bool = False
    core: bool = True


class Parameters:
    """Parameter service of the firmware.

    Args:
        parameters: All parameters.
        stored: Name -> value of the persistent parameters that are stored; it changes.
    """

    def __init__(self, parameters: Sequence[FirmwareParameter], stored: dict[str, float]) -> None:
        self._parameters = parameters
        self._stored = stored
        self._table = Toc(PARAM, [TocEntry(p.name, _type_of(p)) for p in parameters])
        self._values = [stored.get(p.name, p.default) for p in parameters]

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
        if self._parameters[number].fixed:
            return []
        if len(data) == 2 + struct.calcsize("<" + self._parameters[number].layout):
            self._set(number, data[2:])
        return [Packet(PARAM, WRITE, data[:2] + self._packed(number))]  # the old value, if the length is wrong

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
        return [Packet(PARAM, MISCELLANEOUS, data[:3] + self._extended(data[0], number))]

    def _extended(self, request: int, number: int) -> bytes:
        """Return the answer to a request on a default or a persistent value: a state or an error, and values."""
        parameter = self._parameters[number] if number < len(self._parameters) else None
        if parameter is None or not (parameter.persistent or request == DEFAULT_VALUE):
            return bytes((errno.ENOENT,))
        default, stored = self._value(number, parameter.default), self._stored.get(parameter.name)
        if request == STORE:
            self._stored[parameter.name] = self._values[number]
        if request == CLEAR:
            self._stored.pop(parameter.name, None)
        state = b"\0" + default if stored is None else b"\1" + default + self._value(number, stored)
        answers = {
            DEFAULT_VALUE: b"\0" + default, EXTENDED_TYPE: bytes((0, PERSISTENT)), GET_STATE: state, STORE: b"\0",
            CLEAR: b"\0",
        }  # fmt: skip
        return answers.get(request, bytes((errno.ENOENT,)))

    def _set(self, number: int, value: bytes) -> None:
        parameter = self._parameters[number]
        if not parameter.fixed:
            (new,) = struct.unpack("<" + parameter.layout, value)
            self._values[number] = new
            parameter.changed(new)

    def _packed(self, number: int) -> bytes:
        return self._value(number, self._values[number])

    def _value(self, number: int, value: float) -> bytes:
        """Return a value of a parameter in its storage format."""
        layout = self._parameters[number].layout
        return struct.pack("<" + layout, value if layout == "f" else int(value))
