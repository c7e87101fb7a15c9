"""Packets of the Crazyflie's protocol: a port, a channel and up to 30 bytes."""

from typing import NamedTuple

DATA_MAX = 30
NULL = 0xFF  # header of a packet that says nothing: it asks whether somebody is there

CONSOLE, PARAM, COMMANDER, MEMORY, LOG, LOCALISATION, GENERIC, HIGH_LEVEL, SUPERVISOR = 0, 2, 3, 4, 5, 6, 7, 8, 9
PLATFORM, LINK = 13, 15


class Packet(NamedTuple):
    """One packet, either way.

    Attributes:
        port: Which part of the firmware it is for or from, 0 .. 15.
        channel: 0 .. 3.
        data: At most `DATA_MAX` bytes; all numbers in it are little-endian.
    """

    port: int
    channel: int
    data: bytes

    @property
    def wire(self) -> bytes:
        """As it travels: a header byte, of which two bits are always set, and the data."""
        return bytes((self.port << 4 | 0x0C | self.channel,)) + self.data


def packet(wire: bytes) -> Packet | None:
    """The packet that these bytes are; None if they are none, or one that says nothing."""
    if not 1 <= len(wire) <= 1 + DATA_MAX or wire[0] == NULL:
        return None
    return Packet(wire[0] >> 4, wire[0] & 0x03, wire[1:])
