"""Periodic setpoints for a Crazyflie."""

import math
import time
from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array, read_only
from plants.crazyflie.connection.link import Link
from plants.crazyflie.flying.bounds import Bounds, allowed_height
from plants.crazyflie.flying.telemetry import Telemetry

APPROACH_GAIN, APPROACH_MAX = 1.0, 0.5  # 1/s and m/s: velocity towards a point per m of distance, and its bound
STOPPING = 0.4  # s; the stopping distance is that of the present velocity in this time
FIRMWARE_KP = 2.0  # 1/s: vertical velocity per m of error in the firmware's position controller


class Point(NamedTuple):
    """Point to hover at, in m, under velocity setpoints."""

    x: float
    y: float
    z: float


class Goal(NamedTuple):
    """Point to fly to, in m, under the firmware's position controller; heading in rad."""

    x: float
    y: float
    z: float
    heading: float


class Velocity(NamedTuple):
    """Horizontal velocity (m/s, world frame) and a height (m) that changes by `climb` (m/s) from `since` (s) on."""

    east: float
    north: float
    height: float
    climb: float
    since: float


class SetpointStream:
    """Setpoints that are sent periodically. Commands can come from any thread; the autopilot's thread calls `send`.

    Args:
        link: Link to the drone.
        telemetry: Telemetry of the drone.
        bounds: Limits of the flight.
    """

    def __init__(self, link: Link, telemetry: Telemetry, bounds: Bounds) -> None:
        self._link = link
        self._telemetry = telemetry
        self._bounds = bounds
        self._target: Point | Goal | Velocity = Point(0.0, 0.0, 0.0)  # replaced as a whole
        self._commanded: float | None = None  # instant of the last command; None while none are expected

    @property
    def command_age(self) -> float:
        """Time since the last command, in s; 0 while none are expected."""
        return 0.0 if self._commanded is None else time.monotonic() - self._commanded

    def expect_commands(self) -> None:
        """Expect periodic commands from now on: the control loop runs."""
        self._commanded = time.monotonic()

    def keep_to(self, point: Point) -> None:
        """Hover at a nearby point."""
        self._target = point._replace(z=allowed_height(point.z))

    def hold(self) -> None:
        """Brake and hover at the stopping point. This is a command."""
        self._commanded = time.monotonic()
        self.brake()

    def follow(self, velocity: Array, height: float) -> None:
        """Fly at a velocity. This is a command.

        A vertical velocity becomes a changing height: under velocity setpoints the firmware does not hold the height.

        Args:
            velocity: Velocity, shape (2,) or (3,), in m/s, world frame.
            height: Height for a velocity of shape (2,), in m.
        """
        now = self._commanded = time.monotonic()
        east, north = shortened(velocity[:2], self._bounds.speed_max)
        climb = 0.0
        if len(velocity) == 3:
            climb = float(np.clip(velocity[2], -self._bounds.speed_max, self._bounds.speed_max))
            here = float(self._telemetry.motion.position[2])
            height = here + climb / FIRMWARE_KP  # the distance at which the firmware climbs at that rate
        self._target = Velocity(east, north, height, climb, now)

    def fly_to(self, position: Array, height: float, heading: float) -> None:
        """Fly to a position. This is a command.

        Args:
            position: Position, shape (2,) or (3,), in m.
            height: Height for a position of shape (2,), in m.
            heading: Heading, in rad.
        """
        self._commanded = time.monotonic()
        x, y, z = (float(component) for component in [*position, height][:3])
        self._target = Goal(x, y, allowed_height(z), heading)

    def brake(self) -> None:
        """Hover at the stopping point, unless the drone hovers already."""
        if not isinstance(self._target, Point):
            self.halt()

    def halt(self) -> None:
        """Hover at the present stopping point."""
        target = self._target
        x, y, z = (float(component) for component in self._telemetry.motion.position_after(STOPPING))
        self.keep_to(Point(x, y, target.height if isinstance(target, Velocity) and not target.climb else z))

    def send(self) -> None:
        """Send one setpoint; brake if the last command is too old."""
        if self.command_age > self._bounds.hold_after:
            self.brake()
        now, motion, target = time.monotonic(), self._telemetry.motion, self._target
        commander = self._link.commander
        if isinstance(target, Goal):
            commander.send_position_setpoint(target.x, target.y, target.z, math.degrees(target.heading))
            return
        if isinstance(target, Velocity):
            east, north = target.east, target.north
            height = allowed_height(target.height + target.climb * (now - target.since))
        else:
            here = motion.position_after(min(motion.age, self._bounds.state_age_max))
            away = np.array(target[:2]) - here[:2]
            east, north = shortened(APPROACH_GAIN * away, min(APPROACH_MAX, self._bounds.speed_max))
            height = target.z
        cosine, sine = math.cos(motion.yaw), math.sin(motion.yaw)  # hover setpoints are in the body's frame
        commander.send_hover_setpoint(cosine * east + sine * north, cosine * north - sine * east, 0.0, height)


def shortened(vector: Array, longest: float) -> tuple[float, float]:
    """Return the horizontal `vector`, scaled down to the length `longest` if it is longer."""
    length = float(np.linalg.norm(vector))
    x, y = (float(component) for component in read_only(vector) * (min(1.0, longest / length) if length else 1.0))
    return x, y
