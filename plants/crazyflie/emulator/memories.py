"""Memories of the drone that clients read and write; the only one has geometry and calibration of base stations."""

import errno
import struct
from collections.abc import Mapping

from plants.crazyflie.emulator.crtp import LOCALISATION, MEMORY, Packet

INFORMATION, READ, WRITE = 0, 1, 2  # channels
COUNT, DETAILS = 1, 2
LIGHTHOUSE = 0x14  # type of the memory
STATIONS = 16  # largest number in any configuration of the firmware
PAGE, CALIBRATIONS = 0x100, 0x1000  # bytes per base station; first address of calibrations
GEOMETRY_SIZE, CALIBRATION_SIZE = 49, 61  # the last byte of each is its validity
SIZE = 0x2000
PERSIST = 0x0B
REFRESH = 350  # ms; base stations without light leave the log within 0.7 s, as measured on the firmware of 2026.08


class Lighthouse:
    """Lighthouse deck: stored base stations, and those that are received.

    Args:
        origins: Channel -> position, m, of the initially stored base stations; they face along x and are calibrated.

    Attributes:
        received: Bits of the base stations whose light is received.
        logged: Bits of the base stations that the log shows as used: those used since the last update but one.
    """

    def __init__(self, origins: Mapping[int, tuple[float, float, float]]) -> None:
        self._pages = bytearray(SIZE)
        for station, origin in origins.items():
            pose = struct.pack("<12f?", *origin, 1, 0, 0, 0, 1, 0, 0, 0, 1, True)
            calibration = struct.pack("<14fI?", *[0.0] * 14, 0x1000 + station, True)
            self._pages[station * PAGE : station * PAGE + len(pose)] = pose
            begin = CALIBRATIONS + station * PAGE
            self._pages[begin : begin + len(calibration)] = calibration
        self._stored = bytearray(self._pages)
        self.received = sum(1 << station for station in origins)
        self.logged = self._used = self.active

    @property
    def geometries(self) -> int:
        """Bits of the base stations whose geometry is valid."""
        return self._valid(GEOMETRY_SIZE - 1)

    @property
    def calibrations(self) -> int:
        """Bits of the base stations whose calibration is valid."""
        return self._valid(CALIBRATIONS + CALIBRATION_SIZE - 1)

    @property
    def active(self) -> int:
        """Bits of the base stations that the estimator uses."""
        return self.received & self.geometries & self.calibrations

    @property
    def status(self) -> int:
        """Status: 0, no base station is received; 1, none of the received ones is usable; 2, at least one is used."""
        return 2 if self.active else int(self.received > 0)

    def step(self, now: int) -> None:
        """Note which base stations are used in the slot at `now`, ms; update what the log shows when it is due."""
        self._used |= self.active
        if now % REFRESH == 0:
            self.logged, self._used = self._used, 0

    def receive(self, channel: int, data: bytes) -> list[Packet]:
        """Handle a packet on the port of memories; return the answers."""
        if channel == INFORMATION:
            return self._information(data)
        error, read = self._access(channel, data)
        return [Packet(MEMORY, channel, data[:5] + bytes((error,)) + read)]

    def persist(self, data: bytes) -> list[Packet]:
        """Store base stations over a restart, as requested by a packet on the port of localisation."""
        masks = struct.unpack("<HH", data[1:5])
        for begin, mask in zip((0, CALIBRATIONS), masks, strict=True):
            for page in (begin + PAGE * station for station in range(STATIONS) if mask >> station & 1):
                self._stored[page : page + PAGE] = self._pages[page : page + PAGE]
        return [Packet(LOCALISATION, 1, data[:1] + b"\1")]

    def restart(self) -> None:
        """Restore the stored base stations."""
        self._pages = bytearray(self._stored)

    def _information(self, data: bytes) -> list[Packet]:
        if data[0] == COUNT:
            return [Packet(MEMORY, INFORMATION, bytes((COUNT, 1)))]
        if data[0] == DETAILS and data[1] == 0:
            return [Packet(MEMORY, INFORMATION, struct.pack("<BBBI8x", DETAILS, 0, LIGHTHOUSE, SIZE))]
        return [Packet(MEMORY, INFORMATION, data[:2])]

    def _access(self, channel: int, data: bytes) -> tuple[int, bytes]:
        """Read or write; return the error number, 0 for success, and the bytes read."""
        memory, address = struct.unpack("<BI", data[:5])
        written = data[5:] if channel == WRITE else b""
        end = address + (data[5] if channel == READ else len(written))
        if memory != 0 or channel not in (READ, WRITE):
            return errno.ENOENT, b""
        if end > SIZE:
            return errno.EIO, b""
        if channel == WRITE:
            self._pages[address:end] = written
            return 0, b""
        return 0, bytes(self._pages[address:end])

    def _valid(self, offset: int) -> int:
        return sum(1 << station for station in range(STATIONS) if self._pages[station * PAGE + offset])
