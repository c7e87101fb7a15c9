"""Real Crazyflie as a plant: by Crazyradio, USB, UDP or TCP."""

import atexit
import logging
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from dcf_zenoh.errors import PlantError
from dcf_zenoh.plant import Array, Check, Plant, Setpoint, State
from plants.crazyflie.connection.connecting import connect
from plants.crazyflie.connection.link import Link
from plants.crazyflie.connection.outbox import POLL
from plants.crazyflie.connection.uri import check_uri, drone_of, radio_of
from plants.crazyflie.flying.autopilot import Autopilot
from plants.crazyflie.flying.bounds import HEIGHT, Bounds, check_range
from plants.crazyflie.flying.geometry import install
from plants.crazyflie.flying.inspection import inspect
from plants.crazyflie.flying.pose import PoseFeed
from plants.crazyflie.flying.setpoint_stream import Point
from plants.crazyflie.flying.telemetry import ARMED, Telemetry
from plants.crazyflie.flying.watchdog import link_lost
from plants.crazyflie.options import (
    ConnectionOptions,
    HardwareFlightOptions,
    LocalisationOptions,
    WatchdogOptions,
    lead_of,
    reference_for,
)

log = logging.getLogger(__name__)

ARMING = 3.0  # s
STILL, STILL_FOR = 0.1, 1.0  # m/s and s: the drone hovers when it has been slower for that long
SETTLING = 10.0  # s
STUCK = 0.5  # s beyond the allowed age of the state after which the autopilot counts as blocked


class ConnectedDrone(NamedTuple):
    """Connected drone: its link, telemetry and autopilot."""

    link: Link
    telemetry: Telemetry
    autopilot: Autopilot


class CrazyflieHardware(Plant):
    """Real Crazyflie 2.x with a positioning system, such as Lighthouse, flown through cflib.

    A planar acceleration becomes a horizontal velocity at constant height, which is sent in the body's frame, rotated
    by the measured heading; so the heading does not matter. An acceleration in space becomes a velocity and a changing
    height. On a setpoint without acceleration the drone brakes and holds the point where it can stop.

    The autopilot's thread sends setpoints and runs the watchdog, independently of the control loop. The drone lands by
    itself when its battery is low, its state is stale, its position is not measured any more, commands are missing or
    the link is lost; from then on `sense` and `act` raise a `PlantError` with the reason. Take-off, flight to the start
    and landing are left to the firmware's planner. If the program ends while the drone is in the air, `close` lands it.

    Args:
        agent: Id of the agent.
        start: Start position, shape (2,) or (3,), in m. A third component replaces `flight.height`.
        sample_time: Sample time t_s, in s.
        uri: URI of the drone: "radio://0/80/2M/E7E7E7E701", "usb://0", "udp://127.0.0.1:19850", "tcp://HOST:PORT".
        flight: Height, reference, beginning, speed limit and rate of the setpoints.
        watchdog: Limits for battery, age of the state, missing commands and a lost position.
        connection: Time-out, retries and cache of the connection.
        localisation: Geometry of base stations, or an external pose.

    Raises:
        ValueError: An option is out of its range, or the reference does not follow at this sample time.

    Source: Memon et al. for the reference "velocity".
    """

    real: ClassVar[bool] = True
    landing_time: ClassVar[float] = 25.0
    own_keys: ClassVar[tuple[str, ...]] = ("uri",)
    RENAMED: ClassVar[Mapping[str, str]] = {
        "height": "flight.height",
        "reference": "flight.reference",
        "begin": "flight.begin",
        "speed_max": "flight.speed_max",
        "rate": "flight.rate",
        "battery_min": "watchdog.battery_min",
        "battery_low": "watchdog.battery_low",
        "state_age_max": "watchdog.state_age_max",
        "hold_after": "watchdog.hold_after",
        "land_after": "watchdog.land_after",
        "connect_timeout": "connection.timeout",
        "retries": "connection.retries",
        "cache": "connection.cache",
        "geometry": "localisation.geometry",
        "pose": "localisation.pose",
        "pose_endpoint": "localisation.pose_endpoint",
    }

    def __init__(
        self,
        agent: int,
        start: Array,
        sample_time: float,
        *,
        uri: str,
        flight: HardwareFlightOptions = HardwareFlightOptions(),  # noqa: B008 - frozen
        watchdog: WatchdogOptions = WatchdogOptions(),  # noqa: B008 - frozen
        connection: ConnectionOptions = ConnectionOptions(),  # noqa: B008 - frozen
        localisation: LocalisationOptions = LocalisationOptions(),  # noqa: B008 - frozen
    ) -> None:
        check_uri(uri)
        if len(start) not in (2, 3):
            raise ValueError(f"start must be [x, y] or [x, y, z], in m, not {start.tolist()}")
        self._height = float(start[2]) if len(start) == 3 else flight.height
        check_range("height", self._height, *HEIGHT, "m")
        self._bounds = flight_bounds(flight, watchdog, sample_time)
        self._name = f"agent {agent}"
        self._start = Point(float(start[0]), float(start[1]), self._height)
        self._sample_time = sample_time
        self._uri = uri
        self._reference = reference_for(flight.reference, sample_time)
        self._lead = lead_of(self._reference, sample_time)
        self._placed = flight.begin == "placed"
        self._connection = connection
        self._cache = Path(connection.cache).expanduser() if connection.cache else _default_cache()
        self._geometry = Path(localisation.geometry).expanduser() if localisation.geometry else None
        pose = localisation.pose.replace("{agent}", str(agent))
        self._pose = PoseFeed(pose, localisation.pose_endpoint) if pose else None
        self._drone: ConnectedDrone | None = None
        self._checks: tuple[Check, ...] = ()
        self._velocity_reference: Array | None = None
        self._heading = 0.0

    @classmethod
    def owned(cls, key: str, value: object) -> object:  # noqa: ARG003 - the only key is uri
        """Return a key of the drone, independent of the radio that reaches it."""
        return drone_of(str(value))

    @classmethod
    def device(cls, key: str, value: object) -> str:  # noqa: ARG003 - the only key is uri
        """Return the radio that reaches the drone."""
        return radio_of(str(value))

    def prepare(self) -> Iterator[float]:
        """Connect and start the telemetry; `connection.timeout` at most, typically 0.5 s with the tables in the cache.

        Raises:
            PlantError: cflib is not installed, the drone does not answer, or its firmware is too old.
        """
        with self._naming_agent():
            if self._pose is not None:
                self._pose.open()
            atexit.register(self.close)  # lands the drone if the program ends without calling `close`
            options = self._connection
            link = yield from connect(self._uri, self._cache, timeout=options.timeout, retries=options.retries)
            telemetry = Telemetry(link)
            self._drone = ConnectedDrone(link, telemetry, Autopilot(link, telemetry, self._bounds, self._pose))
            yield from telemetry.listen()
            self._drone.autopilot.start()

    def inspect(self) -> Iterator[float]:
        """Reset the estimator, wait until it has converged, and run the checks before a flight.

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
        """Return the results of `inspect`."""
        return self._checks

    def arm(self) -> Iterator[float]:
        """Arm the motors; 3 s at most.

        Raises:
            PlantError: The drone refuses.
        """
        link, telemetry, _ = self._connected()
        with self._naming_agent():
            until = time.monotonic() + ARMING
            link.high_level.stop()  # clears the planner, which may refuse to take off otherwise
            while not telemetry.health.has(ARMED):
                if time.monotonic() > until:
                    raise PlantError(f"it was not armed within {ARMING:g} s: {link.lost or 'it refuses'}")
                link.arm(True)
                yield 4 * POLL

    def take_off(self) -> Iterator[float]:
        """Climb straight up, at 0.4 m/s on average, and hover.

        Raises:
            PlantError: The drone does not take off or reach its height; then it lands.
        """
        with self._naming_agent():
            autopilot = self._connected().autopilot
            self._heading = self._connected().telemetry.motion.yaw
            yield from autopilot.take_off(self._height)

    def settle(self) -> Iterator[float]:
        """Wait until the drone has hovered still for 1 s; 10 s at most.

        Raises:
            PlantError: The drone does not hover still.
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
            PlantError: The drone does not reach the start; then it lands.
        """
        with self._naming_agent():
            yield from self._flying().autopilot.go_to(self._start)

    def start(self, now: int) -> None:  # noqa: ARG002
        """Expect commands from now on: the drone lands when they are missing.

        Raises:
            PlantError: The drone does not fly any more.
        """
        self._flying().autopilot.setpoints.expect_commands()

    def resume(self, state: State, now: int) -> None:  # noqa: ARG002
        """Refuse: without setpoints the firmware has stopped the motors before.

        Raises:
            PlantError: Always.
        """
        raise PlantError(
            f"{self._name}: a Crazyflie cannot come back into a run: 2 s after its daemon died the firmware has stopped"
            " its motors; restart the drone, and fly anew"
        )

    def sense(self, now: int) -> State:  # noqa: ARG002
        """Return position and velocity, shape (3,) each: the newest state, extrapolated at constant velocity.

        Raises:
            PlantError: The drone does not fly any more; the message states the reason.
        """
        motion = self._flying().telemetry.motion
        return State(motion.position_after(min(motion.age, self._bounds.state_age_max)), motion.velocity)

    def act(self, setpoint: Setpoint, now: int) -> None:  # noqa: ARG002
        """Follow the setpoint's acceleration through the reference; without one, brake and hover.

        Raises:
            PlantError: The drone does not fly any more, or the setpoint is not finite.
            ValueError: The setpoint has neither 2 nor 3 components.
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
        """Brake, descend at 0.2 m/s, then stop and disarm the motors; `landing_time` at most.

        Raises:
            PlantError: The landing was not observed; the message states the reason.
        """
        if self._drone is not None:
            with self._naming_agent():
                yield from self._land(self._drone)

    def close(self) -> None:
        """Land, if the drone is in the air and the link works; then release the link."""
        atexit.unregister(self.close)
        if self._drone is not None:
            try:
                self._release(self._drone)
            except PlantError as error:  # no caller could handle it
                log.error("%s: %s", self._name, error)
            self._drone = None
        if self._pose is not None:
            self._pose.close()

    def emergency_stop(self) -> None:
        """Stop the motors at once, from any thread; the drone falls and must be restarted."""
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
        """Land; pauses, in s, until the drone stands.

        Raises:
            PlantError: The landing was not observed.
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
        """Return the velocity that `setpoint` leads to within one sample, in as many dimensions as it has."""
        acceleration = setpoint.acceleration
        if self._reference == "planned" or acceleration is None:
            return setpoint.velocity
        size = len(acceleration)
        before = self._connected().telemetry.motion.velocity[:size]
        if self._reference == "integrated" and self._velocity_reference is not None:
            before = self._velocity_reference
        self._velocity_reference = before + acceleration * self._lead
        return self._velocity_reference

    def _connected(self) -> ConnectedDrone:
        if self._drone is None:
            raise PlantError(f"{self._name}: it is not connected")
        return self._drone

    def _flying(self) -> ConnectedDrone:
        """Return the drone, if it flies under commands.

        Raises:
            PlantError: It does not; the message states the reason.
        """
        drone = self._connected()
        autopilot = drone.autopilot
        if failure := autopilot.failure or ("" if autopilot.airborne else "it has landed"):
            out_of_reach = autopilot.airborne and drone.link.lost
            state = "out of reach" if out_of_reach else "is landing" if autopilot.airborne else "landed"
            raise PlantError(f"{self._name}: {state}: {failure}")
        age, allowed = drone.telemetry.motion.age, self._bounds.state_age_max
        if age > allowed + STUCK:  # the autopilot has not reported it, since the link blocks
            raise PlantError(f"{self._name}: its state is {age:.2f} s old, at most {allowed:g} s is allowed")
        return drone

    @contextmanager
    def _naming_agent(self) -> Iterator[None]:
        """Add the name of the agent to every `PlantError`."""
        try:
            yield
        except PlantError as error:
            text = str(error)
            raise PlantError(text if text.startswith(self._name) else f"{self._name}: {text}") from error


def flight_bounds(flight: HardwareFlightOptions, watchdog: WatchdogOptions, sample_time: float) -> Bounds:
    """Return the limits of a flight, with the defaults that depend on the sample time."""
    hold_after = max(0.5, 2.5 * sample_time) if watchdog.hold_after is None else watchdog.hold_after
    return Bounds(
        rate=flight.rate,
        speed_max=flight.speed_max,
        state_age_max=watchdog.state_age_max,
        hold_after=hold_after,
        land_after=hold_after + 2.0 if watchdog.land_after is None else watchdog.land_after,
        battery_min=watchdog.battery_min,
        battery_low=watchdog.battery_low,
        unmeasured_after=watchdog.unmeasured_after,
        variance_max=watchdog.variance_max,
        position_lost=watchdog.position_lost,
    )


def _default_cache() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "dcf-zenoh" / "crazyflie"
