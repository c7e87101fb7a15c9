"""Packets of the Crazyflie real-time protocol (CRTP): a port, a channel and up to 30 bytes."""

from typing import NamedTuple

DATA_MAX = 30
NULL = 0xFF  # header of an empty packet, used as a probe

CONSOLE, PARAM, COMMANDER, MEMORY, LOG, LOCALISATION, GENERIC, HIGH_LEVEL, SUPERVISOR = 0, 2, 3, 4, 5, 6, 7, 8, 9
PLATFORM, LINK = 13, 15


class Packet(NamedTuple):
    """One packet, in either direction.

    Attributes:
        port: Service of the firmware that receives or sends the packet, 0 .. 15.
        channel: Channel of the port, 0 .. 3.
        data: Payload, at most `DATA_MAX` bytes; all numbers in it are little-endian.
    """

    port: int
    channel: int
    data: bytes

    @property
    def wire(self) -> bytes:
        """Encoded packet: a header byte, with two bits always set, and the data."""
        return bytes((self.port << 4 | 0x0C | self.channel,)) + self.data


def packet(wire: bytes) -> Packet | None:
    """Decode a packet; None if the bytes are not a packet, or an empty one."""
    if not 1 <= len(wire) <= 1 + DATA_MAX or wire[0] == NULL:
        return None
    return Packet(wire[0] >> 4, wire[0] & 0x03, wire[1:])
