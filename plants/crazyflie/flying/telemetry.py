"""Telemetry of a Crazyflie: position and velocity, battery, estimator and supervisor."""

import math
import time
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from dcf_zenoh.errors import PlantError
from dcf_zenoh.plant import Array, read_only
from plants.crazyflie.connection.link import Link
from plants.crazyflie.connection.outbox import POLL

MOTION_PERIOD, HEALTH_PERIOD = 20, 100  # ms
WINDOW = 100  # packets over which the share of received ones is computed
FIRST = 3.0  # s within which the first packet of each kind must be received

MOTION = {
    **dict.fromkeys(["stateEstimate.x", "stateEstimate.y", "stateEstimate.z"], "float"),
    **dict.fromkeys(["stateEstimate.vx", "stateEstimate.vy", "stateEstimate.vz"], "float"),
    "stateEstimate.yaw": "FP16",  # deg; 26 bytes in all, which is what a packet holds
}
HEALTH = {
    "pm.vbat": "float",  # V
    **dict.fromkeys(["kalman.varPX", "kalman.varPY", "kalman.varPZ"], "float"),  # m²
    "supervisor.info": "uint16_t",
}
LIGHTHOUSE = {"lighthouse.bsActive": "uint16_t"}  # one bit for each base station that the estimator uses

CAN_BE_ARMED, ARMED, FLYING, TUMBLED, LOCKED, CRASHED = 0x01, 0x02, 0x10, 0x20, 0x40, 0x80  # of supervisor.info


class Motion(NamedTuple):
    """Position, velocity and heading from the drone's estimator.

    Attributes:
        at: Instant of reception, monotonic clock, in s. For packets that repeat the same position and velocity it is
            that of the first: the estimator has stopped, since in the air no two estimates are exactly equal.
        position: Position, shape (3,), in m, world frame.
        velocity: Velocity, shape (3,), in m/s, world frame.
        yaw: Heading, counter-clockwise from the x axis, in rad.
    """

    at: float
    position: Array
    velocity: Array
    yaw: float

    @property
    def age(self) -> float:
        """Time since the reception, in s."""
        return time.monotonic() - self.at

    def position_after(self, elapsed: float) -> Array:
        """Return the position `elapsed` s later at constant velocity, shape (3,), in m."""
        return read_only(self.position + self.velocity * elapsed)


class Health(NamedTuple):
    """Battery, estimator variance and supervisor state.

    Attributes:
        at: Instant of reception, monotonic clock, in s.
        battery: Battery voltage, in V.
        variance: Variance of the estimated position, shape (3,), in m².
        supervisor: State bits of the firmware's supervisor.
        base_stations: Number of Lighthouse base stations that the estimator uses; None if the drone does not log it.
    """

    at: float
    battery: float
    variance: Array
    supervisor: int
    base_stations: int | None

    @property
    def age(self) -> float:
        """Time since the reception, in s."""
        return time.monotonic() - self.at

    def has(self, bit: int) -> bool:
        """Return whether a state bit is set."""
        return bool(self.supervisor & bit)


class Telemetry:
    """Newest motion and health of a drone.

    Both are replaced as a whole on the thread that receives packets, and can be read on any thread.

    Args:
        link: Link to the drone.

    Attributes:
        received_share: Share of the motion packets of the last 2 s that have been received, 0 to 1.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._motion: Motion | None = None
        self._health: Health | None = None
        self._last_values: list[float] = []  # this and the next: used on the receiving thread only
        self._stamps: deque[int] = deque(maxlen=WINDOW)
        self.received_share = 0.0

    def listen(self) -> Iterator[float]:
        """Start the log blocks; pauses, in s, until the first packet of each is received.

        Raises:
            PlantError: The firmware lacks a variable, or no packet is received.
        """
        for name in (*MOTION, *HEALTH):
            if not self._link.has_variable(name):
                raise PlantError(f"its firmware cannot log {name}: update it (and does it run the Kalman estimator?)")
        lighthouse = {name: kind for name, kind in LIGHTHOUSE.items() if self._link.has_variable(name)}
        yield from self._link.subscribe("motion", MOTION, MOTION_PERIOD, self._receive_motion)
        yield from self._link.subscribe("health", HEALTH | lighthouse, HEALTH_PERIOD, self._receive_health)
        deadline = time.monotonic() + FIRST
        while self._motion is None or self._health is None:
            if time.monotonic() > deadline or self._link.lost:
                raise PlantError(f"its state did not come within {FIRST:g} s: {self._link.lost or 'no log packets'}")
            yield POLL

    @property
    def motion(self) -> Motion:
        """Newest motion; available once `listen` is done."""
        assert self._motion is not None
        return self._motion

    @property
    def health(self) -> Health:
        """Newest health; available once `listen` is done."""
        assert self._health is not None
        return self._health

    def _receive_motion(self, instant: int, values: dict[str, float]) -> None:
        *current, yaw = (values[name] for name in MOTION)
        if current != self._last_values:
            self._last_values = current
            self._motion = Motion(time.monotonic(), read_only(current[:3]), read_only(current[3:]), math.radians(yaw))
        self._stamps.append(instant)
        span = (self._stamps[-1] - self._stamps[0]) & 0xFFFFFF  # the drone's clock has 24 bits
        self.received_share = min(1.0, (len(self._stamps) - 1) * MOTION_PERIOD / span) if span else 0.0

    def _receive_health(self, _instant: int, values: dict[str, float]) -> None:
        battery, *variance, supervisor = (values[name] for name in HEALTH)
        stations = values.get("lighthouse.bsActive")
        count = None if stations is None else int(stations).bit_count()
        self._health = Health(time.monotonic(), battery, read_only(variance), int(supervisor), count)
