"""Lighthouse deck: geometry and calibration of base stations, in a memory that clients read and write."""

import struct
from collections.abc import Mapping
from typing import ClassVar

from plants.crazyflie.emulator.crtp import LOCALISATION, Packet

STATIONS = 16  # largest number in any configuration of the firmware
PAGE, CALIBRATIONS = 0x100, 0x1000  # bytes per base station; first address of calibrations
GEOMETRY_SIZE, CALIBRATION_SIZE = 49, 61  # the last byte of each is its validity
SIZE = 0x2000
PERSIST = 0x0B
DECK_SILENT = 1500  # ms without a word from the deck that are a fault of it
REFRESH = 350  # ms; base stations without light leave the log within 0.7 s, as measured on the firmware of 2026.08


class Lighthouse:
    """Lighthouse deck: stored base stations, and those that are received.

    Args:
        origins: Channel -> position, m, of the initially stored base stations; they face along x and are calibrated.

    Attributes:
        received: Bits of the base stations whose light is received.
        silent: The deck has stopped sending, as if it were loose.
        logged: Bits of the base stations that the log shows as used: those used since the last update but one.
    """

    kind: ClassVar[int] = 0x14
    size: ClassVar[int] = SIZE

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
        self.silent = False
        self._heard = 0
        self._now = 0
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
        return 0 if self.silent else self.received & self.geometries & self.calibrations

    @property
    def faulty(self) -> bool:
        """Whether the deck has been silent for too long."""
        return self._now - self._heard > DECK_SILENT

    @property
    def status(self) -> int:
        """Status: 0, no base station is received; 1, none of the received ones is usable; 2, at least one is used."""
        return 2 if self.active else int(self.received > 0)

    def step(self, now: int) -> None:
        """Note which base stations are used in the slot at `now`, ms; update what the log shows when it is due."""
        self._now = now
        if not self.silent:
            self._heard = now
        self._used |= self.active
        if now % REFRESH == 0:
            self.logged, self._used = self._used, 0

    def read(self, address: int, length: int) -> bytes:
        """Return stored bytes."""
        return bytes(self._pages[address : address + length])

    def write(self, address: int, data: bytes) -> None:
        """Change stored bytes, up to a restart."""
        self._pages[address : address + len(data)] = data

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

    def _valid(self, offset: int) -> int:
        return sum(1 << station for station in range(STATIONS) if self._pages[station * PAGE + offset])
