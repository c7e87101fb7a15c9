"""The setpoints that keep a Crazyflie in the air."""

import math
import time
from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array, read_only
from plants.crazyflie.connection.link import Link
from plants.crazyflie.flying.bounds import Bounds, allowed_height
from plants.crazyflie.flying.telemetry import Telemetry

APPROACH, APPROACH_MAX = 1.0, 0.5  # 1/s and m/s: velocity towards a point for each m, and at most
STOPPING = 0.4  # s; how long the velocity of before carries on until it has stopped
FIRMWARE_KP = 2.0  # 1/s: vertical velocity for each m, in the firmware's position controller


class Point(NamedTuple):
    """To hover at, in m: kept to by velocities."""

    x: float
    y: float
    z: float


class Goal(NamedTuple):
    """To fly to, in m, under the firmware's position controller; heading in rad."""

    x: float
    y: float
    z: float
    heading: float


class Velocity(NamedTuple):
    """To fly at, in m/s, world frame, while the height, in m, changes by `climb`, in m/s, from `since` on, in s."""

    east: float
    north: float
    height: float
    climb: float
    since: float


class SetpointStream:
    """What the drone is told again and again. Commands change it, from any thread; `send` is the pilot's.

    Args:
        link: To the drone.
        vitals: What the drone tells.
        bounds: What to keep to.
    """

    def __init__(self, link: Link, vitals: Telemetry, bounds: Bounds) -> None:
        self._link = link
        self._vitals = vitals
        self._bounds = bounds
        self._aim: Point | Goal | Velocity = Point(0.0, 0.0, 0.0)  # replaced as a whole
        self._commanded: float | None = None  # when the last command came, once there have to be any

    @property
    def command_age(self) -> float:
        """Time since the last command, in s; 0 before there have to be any."""
        return 0.0 if self._commanded is None else time.monotonic() - self._commanded

    def expect_commands(self) -> None:
        """From now on commands have to come again and again: the control loop runs."""
        self._commanded = time.monotonic()

    def keep_to(self, point: Point) -> None:
        """Hover at a point that is near."""
        self._aim = point._replace(z=allowed_height(point.z))

    def hold(self) -> None:
        """A command: brake, and hover where it can stop."""
        self._commanded = time.monotonic()
        self.brake()

    def follow(self, velocity: Array, height: float) -> None:
        """A command: fly at a `velocity`, shape (2,) or (3,), in m/s, world frame; in the plane at `height`, in m.

        A velocity in space becomes a height that changes: commanded as a velocity, the firmware does not hold it.
        """
        now = self._commanded = time.monotonic()
        east, north = shortened(velocity[:2], self._bounds.speed_max)
        climb = 0.0
        if len(velocity) == 3:
            climb = float(np.clip(velocity[2], -self._bounds.speed_max, self._bounds.speed_max))
            height = float(self._vitals.motion.position[2]) + climb / FIRMWARE_KP  # so far ahead, it asks for `climb`
        self._aim = Velocity(east, north, height, climb, now)

    def fly_to(self, position: Array, height: float, heading: float) -> None:
        """A command: fly to a `position`, shape (2,) or (3,), in m; in the plane at `height`, in m."""
        self._commanded = time.monotonic()
        x, y, z = (float(component) for component in [*position, height][:3])
        self._aim = Goal(x, y, allowed_height(z), heading)

    def brake(self) -> None:
        """Hover where it can stop, if it does not hover yet."""
        if not isinstance(self._aim, Point):
            self.halt()

    def halt(self) -> None:
        """Hover where it can stop, as of now."""
        aim = self._aim
        x, y, z = (float(component) for component in self._vitals.motion.position_after(STOPPING))
        self.keep_to(Point(x, y, aim.height if isinstance(aim, Velocity) and not aim.climb else z))

    def send(self) -> None:
        """One setpoint. When commands stay away for too long, it brakes."""
        if self.command_age > self._bounds.hold_after:
            self.brake()
        now, motion, aim = time.monotonic(), self._vitals.motion, self._aim
        commander = self._link.commander
        if isinstance(aim, Goal):
            commander.send_position_setpoint(aim.x, aim.y, aim.z, math.degrees(aim.heading))
            return
        if isinstance(aim, Velocity):
            east, north = aim.east, aim.north
            height = allowed_height(aim.height + aim.climb * (now - aim.since))
        else:
            here = motion.position_after(min(motion.age, self._bounds.state_age_max))
            away = np.array(aim[:2]) - here[:2]
            east, north = shortened(APPROACH * away, min(APPROACH_MAX, self._bounds.speed_max))
            height = aim.z
        cosine, sine = math.cos(motion.yaw), math.sin(motion.yaw)  # the firmware wants it in the body's frame
        commander.send_hover_setpoint(cosine * east + sine * north, cosine * north - sine * east, 0.0, height)


def shortened(vector: Array, longest: float) -> tuple[float, float]:
    """The horizontal `vector`, or one in its direction that is not too long."""
    length = float(np.linalg.norm(vector))
    x, y = (float(component) for component in read_only(vector) * (min(1.0, longest / length) if length else 1.0))
    return x, y
