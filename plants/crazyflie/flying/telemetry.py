"""What a flying Crazyflie tells of itself: where it is, and how it is."""

import math
import time
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from dcf_zenoh.errors import PlantError
from dcf_zenoh.plant import Array, read_only
from plants.crazyflie.connection.link import Link
from plants.crazyflie.connection.outbox import LOOK

MOTION_PERIOD, HEALTH_PERIOD = 20, 100  # ms
WINDOW = 100  # packets over which the share of those that arrive is counted
FIRST = 3.0  # s until the first of each has to come

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
LIGHTHOUSE = {"lighthouse.bsActive": "uint16_t"}  # one bit for each base station that helps the estimator

CAN_BE_ARMED, ARMED, FLYING, TUMBLED, LOCKED, CRASHED = 0x01, 0x02, 0x10, 0x20, 0x40, 0x80  # of supervisor.info


class Motion(NamedTuple):
    """Where the drone is, as its estimator has it.

    Attributes:
        at: When this came, by the monotonic clock, in s. Where position and velocity come again and again without any
            change, when they came first: then the estimator stands still; in the air nothing stays exactly the same.
        position: Shape (3,), in m, world frame.
        velocity: Shape (3,), in m/s, world frame.
        yaw: Counter-clockwise from the x axis, in rad.
    """

    at: float
    position: Array
    velocity: Array
    yaw: float

    @property
    def age(self) -> float:
        """Time since this came, in s."""
        return time.monotonic() - self.at

    def position_after(self, elapsed: float) -> Array:
        """Where it is `elapsed` s later, if its velocity has not changed."""
        return read_only(self.position + self.velocity * elapsed)


class Health(NamedTuple):
    """How the drone is.

    Attributes:
        at: When this came, by the monotonic clock, in s.
        battery: In V.
        variance: Of the position in the estimator, shape (3,), in m².
        supervisor: Its state bits.
        base_stations: How many of Lighthouse help the estimator; None if the drone does not tell.
    """

    at: float
    battery: float
    variance: Array
    supervisor: int
    base_stations: int | None

    @property
    def age(self) -> float:
        """Time since this came, in s."""
        return time.monotonic() - self.at

    def has(self, bit: int) -> bool:
        """Whether a state bit is set."""
        return bool(self.supervisor & bit)


class Telemetry:
    """The newest of both. They are replaced as a whole on the thread that receives packets, and read by any other.

    Args:
        link: Where they come from.

    Attributes:
        share: Of the packets about motion that arrive, over the last 2 s.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self._motion: Motion | None = None
        self._health: Health | None = None
        self._moving: list[float] = []  # this and the next: of the receiving thread alone
        self._stamps: deque[int] = deque(maxlen=WINDOW)
        self.share = 0.0

    def listen(self) -> Iterator[float]:
        """Have them sent; pauses, in s, until the first of each is there.

        Raises:
            PlantError: The firmware does not know one of the variables, or nothing comes.
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
            yield LOOK

    @property
    def motion(self) -> Motion:
        """The newest; there is one once `listen` is through."""
        assert self._motion is not None
        return self._motion

    @property
    def health(self) -> Health:
        """The newest; there is one once `listen` is through."""
        assert self._health is not None
        return self._health

    def _receive_motion(self, instant: int, values: dict[str, float]) -> None:
        *moving, yaw = (values[name] for name in MOTION)
        if moving != self._moving:
            self._moving = moving
            self._motion = Motion(time.monotonic(), read_only(moving[:3]), read_only(moving[3:]), math.radians(yaw))
        self._stamps.append(instant)
        span = (self._stamps[-1] - self._stamps[0]) & 0xFFFFFF  # the drone's clock has 24 bits
        self.share = min(1.0, (len(self._stamps) - 1) * MOTION_PERIOD / span) if span else 0.0

    def _receive_health(self, _instant: int, values: dict[str, float]) -> None:
        battery, *variance, supervisor = (values[name] for name in HEALTH)
        stations = values.get("lighthouse.bsActive")
        count = None if stations is None else int(stations).bit_count()
        self._health = Health(time.monotonic(), battery, read_only(variance), int(supervisor), count)
