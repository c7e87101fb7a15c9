"""The Crazyflie as a plant, real: by Crazyradio, USB, UDP or TCP."""

import atexit
import logging
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from dcf_zenoh.errors import PlantError
from dcf_zenoh.plant import Array, Check, Plant, Setpoint, State
from plants.crazyflie.connection.connecting import connect
from plants.crazyflie.connection.link import Link
from plants.crazyflie.connection.outbox import POLL
from plants.crazyflie.connection.uri import check_uri, drone_of
from plants.crazyflie.flying.autopilot import Autopilot
from plants.crazyflie.flying.bounds import HEIGHT, Bounds, check_range
from plants.crazyflie.flying.geometry import install
from plants.crazyflie.flying.inspection import inspect
from plants.crazyflie.flying.pose import PoseFeed
from plants.crazyflie.flying.setpoint_stream import Point
from plants.crazyflie.flying.telemetry import ARMED, Telemetry
from plants.crazyflie.flying.watchdog import link_lost

log = logging.getLogger(__name__)

ARMING = 3.0  # s
STILL, STILL_FOR = 0.1, 1.0  # m/s, and for how long, in s: it hovers
SETTLING = 10.0  # s
STUCK = 0.5  # s


class ConnectedDrone(NamedTuple):
    """One connected drone."""

    link: Link
    telemetry: Telemetry
    autopilot: Autopilot


class CrazyflieHardware(Plant):
    """A real Crazyflie 2.x with a position sensor, such as Lighthouse, flown by way of cflib.

    A planar acceleration becomes a horizontal velocity to hover with at constant height, which goes out in the body's
    frame, turned by the measured heading; so the heading does not matter. An acceleration in space becomes a velocity
    and a height that changes. Without an acceleration it brakes, and keeps to the point where it can stop.

    A thread of its own keeps the stream of setpoints alive and watches, whatever the control loop does. It lands on its
    own when the battery is low, the state is stale, commands stay away or the link is lost; from then on `sense` and
    `act` raise a `PlantError` that says why. Take-off, the way to the start and landing are left to the firmware's
    planner. Where the program ends with the drone in the air, `close` lands it.

    Args:
        agent: Id.
        start: Start position, shape (2,) or (3,), in m. A third component replaces `height`.
        sample_time: t_s, in s.
        uri: Of the drone: "radio://0/80/2M/E7E7E7E701", "usb://0", "udp://127.0.0.1:19850", "tcp://HOST:PORT".
        height: At which it flies, in m.
        reference: What velocity it is told to fly under an acceleration a, see `Crazyflie`.
        begin: "go_to": after the take-off it flies to `start`; "placed": it refuses to fly if it stands farther than
            0.15 m from it.
        speed_max: Longest velocity that it is told, in m/s.
        battery_min: Least voltage at which it takes off, in V.
        battery_low: Least voltage in flight, in V; then it lands.
        state_age_max: Oldest state that it is flown by, in s; then it lands.
        hold_after: Time without a command after which it holds, in s; 0.5, or 2.5 samples if that is longer.
        land_after: Time without a command after which it lands, in s; 2 s more than that.
        rate: Of the stream of setpoints, in Hz.
        connect_timeout: Longest time to connect, in s.
        retries: How often that is tried again.
        cache: Folder for the drone's tables; that of the user's caches.
        geometry: File with the poses of Lighthouse's base stations, which the drone is made to know; by default it
            keeps what it has.
        pose: Key of Zenoh on which another system publishes where the drone is, see `PoseFeed`; ``{agent}`` stands for
            the id. By default the drone measures that itself.
        pose_endpoint: Where that system is to be reached, such as "tcp/192.168.1.5:7447".

    Raises:
        ValueError: An option is out of its range; the message says which.

    Source: Memon et al. for the reference "velocity".
    """

    real: ClassVar[bool] = True
    landing_time: ClassVar[float] = 25.0
    own_keys: ClassVar[tuple[str, ...]] = ("uri",)

    def __init__(
        self,
        agent: int,
        start: Array,
        sample_time: float,
        *,
        uri: str,
        height: float = 0.5,
        reference: Literal["velocity", "planned", "integrated", "position"] = "velocity",
        begin: Literal["go_to", "placed"] = "go_to",
        speed_max: float = 1.0,
        battery_min: float = 3.7,
        battery_low: float = 3.1,
        state_age_max: float = 0.5,
        hold_after: float | None = None,
        land_after: float | None = None,
        rate: float = 50.0,
        connect_timeout: float = 30.0,
        retries: int = 5,
        cache: str = "",
        geometry: str = "",
        pose: str = "",
        pose_endpoint: str = "",
    ) -> None:
        check_uri(uri)
        if len(start) not in (2, 3):
            raise ValueError(f"start must be [x, y] or [x, y, z], in m, not {start.tolist()}")
        self._height = float(start[2]) if len(start) == 3 else height
        check_range("height", self._height, *HEIGHT, "m")
        check_range("connect_timeout", connect_timeout, 1.0, 300.0, "s")
        check_range("retries", retries, 0, 100, "")
        hold_after = max(0.5, 2.5 * sample_time) if hold_after is None else hold_after
        self._bounds = Bounds(
            rate=rate,
            speed_max=speed_max,
            state_age_max=state_age_max,
            hold_after=hold_after,
            land_after=hold_after + 2.0 if land_after is None else land_after,
            battery_min=battery_min,
            battery_low=battery_low,
        )
        self._name = f"agent {agent}"
        self._start = Point(float(start[0]), float(start[1]), self._height)
        self._sample_time = sample_time
        self._uri = uri
        self._reference = reference
        self._placed = begin == "placed"
        self._patience = (connect_timeout, retries)
        self._cache = Path(cache).expanduser() if cache else _default_cache()
        self._geometry = Path(geometry).expanduser() if geometry else None
        self._pose = PoseFeed(pose.replace("{agent}", str(agent)), pose_endpoint) if pose else None
        self._drone: ConnectedDrone | None = None
        self._checks: tuple[Check, ...] = ()
        self._velocity_reference: Array | None = None
        self._heading = 0.0

    @classmethod
    def owned(cls, key: str, value: object) -> object:  # noqa: ARG003 - there is one
        """The drone, whichever radio reaches it."""
        return drone_of(str(value))

    def prepare(self) -> Iterator[float]:
        """Connect, and have the state sent; `connect_timeout` at most, typically 0.5 s with the tables in the cache.

        Raises:
            PlantError: cflib is not installed, the drone does not answer, or its firmware is too old.
        """
        timeout, retries = self._patience
        with self._naming_agent():
            if self._pose is not None:
                self._pose.open()
            atexit.register(self.close)  # in case nobody else does
            link = yield from connect(self._uri, self._cache, timeout=timeout, retries=retries)
            telemetry = Telemetry(link)
            self._drone = ConnectedDrone(link, telemetry, Autopilot(link, telemetry, self._bounds, self._pose))
            yield from telemetry.listen()
            self._drone.autopilot.start()

    def inspect(self) -> Iterator[float]:
        """Start the estimator anew, wait until it knows where it is, and look at all that a flight needs.

        Raises:
            PlantError: The drone does not answer.
        """
        link, telemetry, autopilot = self._connected()
        with self._naming_agent():
            if self._geometry is not None:
                yield from install(link, self._geometry)
            self._checks = yield from inspect(
                link,
                telemetry,
                self._bounds,
                self._start,
                self._pose,
                placed=self._placed,
                left_flying=autopilot.airborne,
            )

    def checks(self) -> tuple[Check, ...]:
        """What `inspect` has found."""
        return self._checks

    def arm(self) -> Iterator[float]:
        """Let the motors turn; 3 s at most.

        Raises:
            PlantError: The drone refuses.
        """
        link, telemetry, _ = self._connected()
        with self._naming_agent():
            until = time.monotonic() + ARMING
            link.high_level.stop()  # forgets what its planner did last; otherwise it may refuse to take off
            while not telemetry.health.has(ARMED):
                if time.monotonic() > until:
                    raise PlantError(f"it was not armed within {ARMING:g} s: {link.lost or 'it refuses'}")
                link.arm(True)
                yield 4 * POLL

    def take_off(self) -> Iterator[float]:
        """Climb straight up, at 0.4 m/s on average, and hover.

        Raises:
            PlantError: It does not take off, or does not come to its height; then it lands.
        """
        with self._naming_agent():
            autopilot = self._connected().autopilot
            self._heading = self._connected().telemetry.motion.yaw
            yield from autopilot.take_off(self._height)

    def settle(self) -> Iterator[float]:
        """Wait until it hovers still for 1 s; 10 s at most.

        Raises:
            PlantError: It does not.
        """
        with self._naming_agent():
            began = quiet_since = time.monotonic()
            while (now := time.monotonic()) - quiet_since < STILL_FOR:
                velocity = self._flying().telemetry.motion.velocity
                speed = float(np.linalg.norm(velocity))
                quiet_since = quiet_since if speed < STILL else now
                if now - began > SETTLING:
                    raise PlantError(f"it did not hover still within {SETTLING:g} s: it moves at {speed:.2f} m/s")
                yield POLL

    def go_to_start(self) -> Iterator[float]:
        """Fly to the start in a straight line, at 0.3 m/s on average.

        Raises:
            PlantError: It does not get there; then it lands.
        """
        with self._naming_agent():
            yield from self._flying().autopilot.go_to(self._start)

    def start(self, now: int) -> None:  # noqa: ARG002
        """From now on it lands when commands stay away.

        Raises:
            PlantError: It does not fly any more.
        """
        self._flying().autopilot.setpoints.expect_commands()

    def resume(self, state: State, now: int) -> None:  # noqa: ARG002
        """Refuse: without a stream of setpoints the firmware has stopped the motors long ago.

        Raises:
            PlantError: Always.
        """
        raise PlantError(
            f"{self._name}: a Crazyflie cannot come back into a run: 2 s after its daemon died the firmware has stopped"
            " its motors; restart the drone, and fly anew"
        )

    def sense(self, now: int) -> State:  # noqa: ARG002
        """Position and velocity, shape (3,) each: the newest, carried on at constant velocity for as long as it is old.

        Raises:
            PlantError: It does not fly any more; the message says why.
        """
        motion = self._flying().telemetry.motion
        return State(motion.position_after(min(motion.age, self._bounds.state_age_max)), motion.velocity)

    def act(self, setpoint: Setpoint, now: int) -> None:  # noqa: ARG002
        """Follow the setpoint's acceleration by way of `reference`; without one, brake and hover.

        Raises:
            PlantError: It does not fly any more, or the setpoint is not finite.
            ValueError: The setpoint is neither planar nor in space.
        """
        setpoints = self._flying().autopilot.setpoints
        if setpoint.acceleration is None:
            self._velocity_reference = None
            setpoints.hold()
            return
        wanted = setpoint.position if self._reference == "position" else self._velocity(setpoint)
        if len(wanted) not in (2, 3):
            raise ValueError(f"a setpoint of {len(wanted)} components for a Crazyflie, which follows 2 or 3")
        if not np.isfinite(wanted).all():
            raise PlantError(f"{self._name}: a setpoint must be finite, not {wanted.tolist()}")
        if self._reference == "position":
            setpoints.fly_to(wanted, self._height, self._heading)
        else:
            setpoints.follow(wanted, self._height)

    def finish(self, now: int, reason: str) -> Iterator[float]:  # noqa: ARG002
        """Brake, sink at 0.2 m/s, stop and disarm the motors, once it stands; `landing_time` at most.

        Raises:
            PlantError: It was not seen to land; the message says why.
        """
        if self._drone is not None:
            with self._naming_agent():
                yield from self._land(self._drone)

    def close(self) -> None:
        """Land, if it is in the air and can be reached; then release the link."""
        atexit.unregister(self.close)
        if self._drone is not None:
            try:
                self._release(self._drone)
            except PlantError as error:  # there is nobody left who could do anything about it
                log.error("%s: %s", self._name, error)
            self._drone = None
        if self._pose is not None:
            self._pose.close()

    def emergency_stop(self) -> None:
        """Stop the motors, from any thread; it falls, and has to be restarted."""
        drone = self._drone
        if drone is not None:
            drone.autopilot.stop()

    def _release(self, drone: ConnectedDrone) -> None:
        if drone.autopilot.airborne and not drone.link.lost:
            for pause in self._land(drone):
                time.sleep(pause)
        drone.autopilot.close()
        drone.link.close()

    def _land(self, drone: ConnectedDrone) -> Iterator[float]:
        """Land; pauses, in s, until it stands.

        Raises:
            PlantError: It was not seen to land.
        """
        link, _, autopilot = drone
        for pause in autopilot.land():
            if autopilot.airborne and link.lost:
                now = link_lost(link.lost, planner_flies=autopilot.planner_flies)
                before = (
                    f"{autopilot.failure}; then "
                    if autopilot.failure and not autopilot.failure.startswith("link lost")
                    else ""
                )
                raise PlantError(f"not seen to land: {before}{now}")
            yield pause
        if autopilot.airborne:
            raise PlantError(f"not seen to land: {autopilot.failure or 'no reason is known'}")

    def _velocity(self, setpoint: Setpoint) -> Array:
        """The velocity that `setpoint` leads to within one sample, in as many dimensions as it has."""
        acceleration = setpoint.acceleration
        if self._reference == "planned" or acceleration is None:
            return setpoint.velocity
        size = len(acceleration)
        before = self._connected().telemetry.motion.velocity[:size]
        if self._reference == "integrated" and self._velocity_reference is not None:
            before = self._velocity_reference
        self._velocity_reference = before + acceleration * self._sample_time
        return self._velocity_reference

    def _connected(self) -> ConnectedDrone:
        if self._drone is None:
            raise PlantError(f"{self._name}: it is not connected")
        return self._drone

    def _flying(self) -> ConnectedDrone:
        """The drone, if it flies as it is told."""
        drone = self._connected()
        autopilot = drone.autopilot
        if failure := autopilot.failure or ("" if autopilot.airborne else "it has landed"):
            out_of_reach = autopilot.airborne and drone.link.lost
            state = "out of reach" if out_of_reach else "is landing" if autopilot.airborne else "landed"
            raise PlantError(f"{self._name}: {state}: {failure}")
        age, allowed = drone.telemetry.motion.age, self._bounds.state_age_max
        if age > allowed + STUCK:  # the pilot would have said so, but waits for the link
            raise PlantError(f"{self._name}: its state is {age:.2f} s old, at most {allowed:g} s is allowed")
        return drone

    @contextmanager
    def _naming_agent(self) -> Iterator[None]:
        """Name the agent in every error of the drone."""
        try:
            yield
        except PlantError as error:
            text = str(error)
            raise PlantError(text if text.startswith(self._name) else f"{self._name}: {text}") from error


def _default_cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "dcf-zenoh" / "crazyflie"
