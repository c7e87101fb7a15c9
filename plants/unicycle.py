"""Differential-drive robot controlled through a look-ahead point."""

from collections.abc import Iterator
from math import cos, pi, sin
from typing import NamedTuple

from dcf_zenoh.plant import Array, Piece, Plant, Setpoint, State, read_only

_PIECE = 2_000_000  # ns


class Pose(NamedTuple):
    """Middle of the axle, in m, and heading, in rad, counter-clockwise from the x axis."""

    x: float
    y: float
    heading: float

    def after(self, speed: float, turn: float, duration: float) -> "Pose":
        """Return the exact pose after `duration` (s) at constant `speed` (m/s) and `turn` rate (rad/s), on an arc."""
        half = turn * duration / 2
        chord = speed * duration * (sin(half) / half if half else 1.0)
        along = self.heading + half
        return Pose(self.x + chord * cos(along), self.y + chord * sin(along), self.heading + 2 * half)


class Unicycle(Plant):
    """Differential-drive robot without slip; a point ahead of its axle moves at the planned velocity.

    The body cannot move sideways. The point p = (x, y) + l (cos heading, sin heading), l > 0, can: with the wheels'
    mean speed v and turn rate w, its velocity is u = v (cos, sin) + l w (-sin, cos), which is solved for

        v = u_x cos + u_y sin,    w = (u_y cos - u_x sin) / l.

    `start`, the targets, the state and the barriers of a problem refer to p. The middle of the axle is l behind it, so
    two bodies can be nearer to each other than their points, by up to the sum of their l.

    The robot computes its wheel speeds every `control_period` from its present heading, and holds them in between; the
    motion is integrated exactly, arc by arc. If a wheel exceeds its maximum speed, both are slowed down by the same
    factor: the path keeps its curvature, and p its direction. Only the setpoint's velocity is used, as by
    `SingleIntegrator`.

    Args:
        start: Start of the look-ahead point, shape (2,), in m. The body starts at rest.
        heading: Heading at the start, in rad.
        look_ahead: Distance l, in m. With a shorter one, p is nearer to the body and the robot turns faster.
        wheel_radius: Radius of the wheels, in m.
        wheel_base: Distance of the wheels, in m.
        wheel_speed_max: Bound on the angular speed of each wheel, in rad/s.
        control_period: Control period of the robot's own computer, in s.

    Raises:
        ValueError: A length, speed or period is not positive, or `start` is not planar.

    Source: Olfati-Saber, "Near-identity diffeomorphisms and exponential epsilon-tracking and epsilon-stabilization of
    first-order nonholonomic SE(2) vehicles", ACC 2002, for the transformation. The defaults are the constants of the
    Robotarium's simulator (robotarium_python_simulator, rps/robotarium_abc.py and its projection distance): 16 mm,
    105 mm, 0.2 m/s on the straight, which is 12.5 rad/s, 33 ms, 50 mm.
    """

    def __init__(
        self,
        start: Array,
        *,
        heading: float = 0.0,
        look_ahead: float = 0.05,
        wheel_radius: float = 0.016,
        wheel_base: float = 0.105,
        wheel_speed_max: float = 12.5,
        control_period: float = 0.033,
    ) -> None:
        for name, value in {
            "look_ahead": look_ahead,
            "wheel_radius": wheel_radius,
            "wheel_base": wheel_base,
            "wheel_speed_max": wheel_speed_max,
            "control_period": control_period,
        }.items():
            if not value > 0:
                raise ValueError(f"{name} must be positive, not {value}")
        if len(start) != 2:
            raise ValueError(f"start must be [x, y] in m, not {start.tolist()}")
        self._look_ahead = look_ahead
        self._rim_speed_max = wheel_radius * wheel_speed_max
        self._half_base = wheel_base / 2
        self._period = max(1, round(control_period * 1e9))
        self._heading = heading % (2 * pi)
        self._speed = self._turn = 0.0
        self._now = 0
        self._since = 0  # instant at which the wheel speeds were last computed, and to which the pose refers
        self._place(start, 0)

    def resume(self, state: State, now: int) -> None:
        """Rest with the look-ahead point at the position of `state`, and the start heading: a state has no heading."""
        self._place(state.position, now)

    def sense(self, now: int) -> State:
        """Return the exact position and velocity of the look-ahead point at `now`."""
        pose = self.pose(now)
        self._now = max(self._now, now)
        ahead, aside = cos(pose.heading), sin(pose.heading)
        speed, across = self._speed, self._look_ahead * self._turn
        return State(
            read_only([pose.x + self._look_ahead * ahead, pose.y + self._look_ahead * aside]),
            read_only([speed * ahead - across * aside, speed * aside + across * ahead]),
        )

    def path(self, until: int) -> Iterator[Piece]:
        """Yield the path up to `until`: parabolas of at most `_PIECE` that meet its arcs at their ends."""
        while self._now < until:
            begin, state = self._now, self.sense(self._now)
            after = self.sense(min(until, begin + _PIECE))
            yield Piece.between(begin, state, self._now, after.position)

    def act(self, setpoint: Setpoint, now: int) -> None:
        """Move the point at the setpoint's velocity from `now` on; stop on a setpoint without acceleration (hold)."""
        self._pose, self._since = self.pose(now), max(now, self._since)
        self._now = max(now, self._now)
        if setpoint.acceleration is None:
            self._wanted = (0.0, 0.0)
        elif setpoint.velocity.shape == (2,):
            self._wanted = (float(setpoint.velocity[0]), float(setpoint.velocity[1]))
        else:
            raise ValueError(f"a setpoint with {len(setpoint.velocity)} velocities for a body in the plane")
        self._turn_wheels()

    def pose(self, now: int) -> Pose:
        """Return the pose of the body at `now`; agents do not measure it."""
        while self._since + self._period <= now:  # the robot's own computer
            self._since, self._pose = self._since + self._period, self._driven(self._since + self._period)
            self._turn_wheels()
        return self._driven(now)

    def _place(self, point: Array, now: int) -> None:
        """Rest with the look-ahead point at `point`."""
        x, y = float(point[0]), float(point[1])
        ahead = self._look_ahead
        self._pose = Pose(x - ahead * cos(self._heading), y - ahead * sin(self._heading), self._heading)
        self._wanted = (0.0, 0.0)
        self._speed = self._turn = 0.0
        self._since = self._now = now

    def _driven(self, now: int) -> Pose:
        return self._pose.after(self._speed, self._turn, max(0, now - self._since) * 1e-9)

    def _turn_wheels(self) -> None:
        """Set the speed and turn rate that give the point the wanted velocity, within the limit of the faster wheel."""
        ahead, aside = cos(self._pose.heading), sin(self._pose.heading)
        wanted_x, wanted_y = self._wanted
        speed = wanted_x * ahead + wanted_y * aside
        turn = (wanted_y * ahead - wanted_x * aside) / self._look_ahead
        fastest = abs(speed) + abs(turn) * self._half_base  # larger of left = v - w b / 2, right = v + w b / 2
        slower = min(1.0, self._rim_speed_max / fastest) if fastest else 1.0
        self._speed, self._turn = speed * slower, turn * slower
