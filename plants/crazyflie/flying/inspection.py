"""Checks before the take-off of a Crazyflie."""

import math
import time
from collections import deque
from collections.abc import Generator, Iterator

import numpy as np

from dcf_zenoh.plant import Check
from plants.crazyflie.connection.link import Link
from plants.crazyflie.connection.outbox import POLL
from plants.crazyflie.flying.bounds import Bounds
from plants.crazyflie.flying.pose import PoseFeed
from plants.crazyflie.flying.setpoint_stream import Point
from plants.crazyflie.flying.telemetry import ARMED, CAN_BE_ARMED, Health, Motion, Telemetry
from plants.crazyflie.flying.watchdog import POSE_AGE_MAX, STOPS

KALMAN = 2
RESETTING = 0.1  # s between the two parameter writes that reset the estimator
SETTLING = 6.0  # s
QUIET_FOR = 1.0  # s for which the variance must be small
VARIANCE_MAX = 0.001  # m²; 3 cm
SHARE_MIN = 0.8  # of the packets
ROUND_TRIP_MAX = 0.2  # s; setpoints are then up to 0.1 s late, half a control period of the swap
ROUND_TRIPS = 10
PLACED = 0.15  # m
CLEARANCE = 0.1  # m; least height of the flight above the ground

DECKS = {"deck.bcLighthouse4": "Lighthouse", "deck.bcLoco": "Loco", "deck.bcDWM1000": "Loco", "deck.bcFlow2": "flow"}


def inspect(
    link: Link,
    telemetry: Telemetry,
    bounds: Bounds,
    start: Point,
    pose: PoseFeed | None,
    *,
    placed: bool,
    left_flying: bool,
) -> Generator[float, None, tuple[Check, ...]]:
    """Reset the estimator and run all checks; pauses, in s, until they are done.

    Args:
        link: Link to the drone.
        telemetry: Telemetry of the drone.
        bounds: Limits of the flight.
        start: Required position before the first step.
        pose: External measurement of the drone's position, if there is one.
        placed: The drone must stand at `start` already.
        left_flying: The drone is in the air, left there by an earlier program.

    Raises:
        PlantError: The drone does not answer.
    """
    if not left_flying:
        yield from _start_estimator(link)
        yield from _settle(telemetry)
    round_trip = yield from _round_trip(link)
    decks = []
    for name, deck in DECKS.items():
        if link.has_parameter(name) and (yield from link.read(name)):
            decks.append(deck)
    motion, health = telemetry.motion, telemetry.health
    return (
        _battery(health, bounds),
        _link(telemetry.received_share, round_trip),
        _localisation(decks, health) if pose is None else _external_pose(pose),
        _estimator(health),
        Check("heading", f"{math.degrees(motion.yaw):.0f} deg"),
        _start_position(motion, start, placed=placed),
        _supervisor(health, left_flying=left_flying),
    )


def _start_estimator(link: Link) -> Iterator[float]:
    for name, value in (("stabilizer.estimator", KALMAN), ("commander.enHighLevel", 1)):
        if link.has_parameter(name):
            yield from link.write(name, value)
    yield from link.write("kalman.resetEstimation", 1)
    yield RESETTING
    yield from link.write("kalman.resetEstimation", 0)


def _settle(telemetry: Telemetry) -> Iterator[float]:
    """Wait until the variance of the position has been small for 1 s, 6 s at most."""
    deadline = time.monotonic() + SETTLING
    recent: deque[tuple[float, float]] = deque()  # instant, variance
    while time.monotonic() < deadline:
        health = telemetry.health
        if not recent or health.at > recent[-1][0]:
            recent.append((health.at, float(health.variance.max())))
        while recent[-1][0] - recent[0][0] > QUIET_FOR:
            recent.popleft()
        if recent[-1][0] - recent[0][0] > 0.8 * QUIET_FOR and max(variance for _, variance in recent) < VARIANCE_MAX:
            return
        yield POLL


def _round_trip(link: Link) -> Generator[float, None, float]:
    """Measure the median round-trip time, in s."""
    times = []
    for number in range(ROUND_TRIPS):
        times.append((yield from link.echo(number)))
    return float(np.median(times))


def _battery(health: Health, bounds: Bounds) -> Check:
    low = health.battery < bounds.battery_min
    return Check("battery", f"{health.battery:.2f} V", f"at least {bounds.battery_min:g} V is needed" if low else "")


def _link(received_share: float, round_trip: float) -> Check:
    value = f"{received_share:.0%} of packets, {round_trip * 1e3:.0f} ms there and back"
    if received_share < SHARE_MIN:
        return Check("link", value, f"at least {SHARE_MIN:.0%} has to be received")
    return Check(
        "link", value, f"at most {ROUND_TRIP_MAX * 1e3:.0f} ms is allowed" if round_trip > ROUND_TRIP_MAX else ""
    )


def _localisation(decks: list[str], health: Health) -> Check:
    if not decks:
        return Check("localisation", "none", "it has neither a deck that measures its position nor an external pose")
    if "Lighthouse" not in decks or health.base_stations is None:
        return Check("localisation", ", ".join(decks))
    seen = f"{health.base_stations} base station{'' if health.base_stations == 1 else 's'}"
    problem = "" if health.base_stations else "it receives none, or has not got their geometry"
    return Check("base stations", seen, problem)


def _external_pose(pose: PoseFeed) -> Check:
    value = f"pose {pose.age * 1e3:.0f} ms old" if math.isfinite(pose.age) else "no pose"
    late = f"at most {POSE_AGE_MAX:g} s is allowed" if pose.age > POSE_AGE_MAX else ""
    return Check("localisation", value, "; ".join(filter(None, (pose.problem, late))))


def _estimator(health: Health) -> Check:
    variance = float(health.variance.max())
    unsure = f"at most {VARIANCE_MAX:g} m² is allowed" if not variance < VARIANCE_MAX else ""
    return Check("estimator", f"variance {variance:.1e} m²", unsure)


def _start_position(motion: Motion, start: Point, *, placed: bool) -> Check:
    x, y, z = (float(component) for component in motion.position)
    away = math.hypot(x - start.x, y - start.y)
    problem = ""
    if placed and away > PLACED:
        problem = f"it stands at [{x:.2f}, {y:.2f}] m; at most {PLACED:g} m is allowed where begin is 'placed'"
    elif start.z - z < CLEARANCE:
        problem = f"its height is {z:.2f} m where it stands; it is to fly at {start.z:g} m"
    return Check("start", f"{away:.2f} m away", problem)


def _supervisor(health: Health, *, left_flying: bool) -> Check:
    for bit, name in STOPS.items():
        if health.has(bit):
            return Check("supervisor", name, "set it upright and restart it")
    if left_flying:
        return Check("supervisor", "flying", "it was left in the air; it lands when this program ends")
    if health.has(ARMED):
        return Check("supervisor", "armed")
    able = health.has(CAN_BE_ARMED)
    return Check("supervisor", "can be armed" if able else "cannot be armed", "" if able else "see its console")
