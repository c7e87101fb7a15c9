"""What is looked at before a Crazyflie takes off."""

import math
import time
from collections import deque
from collections.abc import Generator, Iterator

import numpy as np

from dcf_zenoh.plant import Check
from plants.crazyflie.connection.link import Link
from plants.crazyflie.connection.outbox import LOOK
from plants.crazyflie.flying.bounds import Bounds
from plants.crazyflie.flying.pose import PoseFeed
from plants.crazyflie.flying.setpoint_stream import Point
from plants.crazyflie.flying.telemetry import ARMED, CAN_BE_ARMED, Health, Motion, Telemetry
from plants.crazyflie.flying.watchdog import POSE_AGE_MAX, STOPS

KALMAN = 2
RESETTING = 0.1  # s between the two words that start the estimator anew
SETTLING = 6.0  # s
QUIET_FOR = 1.0  # s for which the estimator has to be sure
VARIANCE_MAX = 0.001  # m²; 3 cm
SHARE_MIN = 0.8  # of the packets
ROUND_TRIP_MAX = 0.2  # s; setpoints then are up to 0.1 s late, half a control period of the swap
ROUND_TRIPS = 10
PLACED = 0.15  # m
CLEARANCE = 0.1  # m from where it stands up to where it flies

DECKS = {"deck.bcLighthouse4": "Lighthouse", "deck.bcLoco": "Loco", "deck.bcDWM1000": "Loco", "deck.bcFlow2": "flow"}


def inspect(
    link: Link,
    vitals: Telemetry,
    bounds: Bounds,
    start: Point,
    pose: PoseFeed | None,
    *,
    placed: bool,
    left_flying: bool,
) -> Generator[float, None, tuple[Check, ...]]:
    """Start the estimator anew and look at everything; pauses, in s, until that is done.

    Args:
        link: To the drone.
        vitals: What the drone tells.
        bounds: What the flight keeps to.
        start: Where it shall be before the first step.
        pose: What measures its position, if it does not do that itself.
        placed: It has to stand there already.
        left_flying: It is in the air, from before.

    Raises:
        PlantError: The drone does not answer.
    """
    if not left_flying:
        yield from _start_estimator(link)
        yield from _settle(vitals)
    round_trip = yield from _round_trip(link)
    decks = []
    for name, deck in DECKS.items():
        if link.has_parameter(name) and (yield from link.read(name)):
            decks.append(deck)
    motion, health = vitals.motion, vitals.health
    return (
        _battery(health, bounds),
        _link(vitals.share, round_trip),
        _localisation(decks, health) if pose is None else _outside(pose),
        _estimator(health),
        Check("heading", f"{math.degrees(motion.yaw):.0f} deg"),
        _place(motion, start, placed=placed),
        _supervisor(health, left_flying=left_flying),
    )


def _start_estimator(link: Link) -> Iterator[float]:
    for name, value in (("stabilizer.estimator", KALMAN), ("commander.enHighLevel", 1)):
        if link.has_parameter(name):
            yield from link.write(name, value)
    yield from link.write("kalman.resetEstimation", 1)
    yield RESETTING
    yield from link.write("kalman.resetEstimation", 0)


def _settle(vitals: Telemetry) -> Iterator[float]:
    """Wait until the estimator is sure of the position and does not change its mind, or for long enough."""
    deadline = time.monotonic() + SETTLING
    seen: deque[tuple[float, float]] = deque()
    while time.monotonic() < deadline:
        health = vitals.health
        if not seen or health.at > seen[-1][0]:
            seen.append((health.at, float(health.variance.max())))
        while seen[-1][0] - seen[0][0] > QUIET_FOR:
            seen.popleft()
        if seen[-1][0] - seen[0][0] > 0.8 * QUIET_FOR and max(variance for _, variance in seen) < VARIANCE_MAX:
            return
        yield LOOK


def _round_trip(link: Link) -> Generator[float, None, float]:
    """Median time of an echo, in s."""
    times = []
    for number in range(ROUND_TRIPS):
        times.append((yield from link.echo(number)))
    return float(np.median(times))


def _battery(health: Health, bounds: Bounds) -> Check:
    low = health.battery < bounds.battery_min
    return Check("battery", f"{health.battery:.2f} V", f"at least {bounds.battery_min:g} V is needed" if low else "")


def _link(share: float, round_trip: float) -> Check:
    value = f"{share:.0%} of packets, {round_trip * 1e3:.0f} ms there and back"
    if share < SHARE_MIN:
        return Check("link", value, f"at least {SHARE_MIN:.0%} has to arrive")
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


def _outside(pose: PoseFeed) -> Check:
    value = f"pose {pose.age * 1e3:.0f} ms old" if math.isfinite(pose.age) else "no pose"
    late = f"at most {POSE_AGE_MAX:g} s is allowed" if pose.age > POSE_AGE_MAX else ""
    return Check("localisation", value, "; ".join(filter(None, (pose.problem, late))))


def _estimator(health: Health) -> Check:
    variance = float(health.variance.max())
    unsure = f"at most {VARIANCE_MAX:g} m² is allowed" if not variance < VARIANCE_MAX else ""
    return Check("estimator", f"variance {variance:.1e} m²", unsure)


def _place(motion: Motion, start: Point, *, placed: bool) -> Check:
    x, y, z = (float(component) for component in motion.position)
    away = math.hypot(x - start.x, y - start.y)
    problem = ""
    if placed and away > PLACED:
        problem = f"it stands at [{x:.2f}, {y:.2f}] m; at most {PLACED:g} m is allowed where begin is 'placed'"
    elif start.z - z < CLEARANCE:
        problem = f"its height is {z:.2f} m where it stands; it is to fly at {start.z:g} m"
    return Check("start", f"{away:.2f} m away", problem)


def _supervisor(health: Health, *, left_flying: bool) -> Check:
    for bit, word in STOPS.items():
        if health.has(bit):
            return Check("supervisor", word, "set it upright and restart it")
    if left_flying:
        return Check("supervisor", "flying", "it was left in the air; it lands when this program ends")
    if health.has(ARMED):
        return Check("supervisor", "armed")
    able = health.has(CAN_BE_ARMED)
    return Check("supervisor", "can be armed" if able else "cannot be armed", "" if able else "see its console")
