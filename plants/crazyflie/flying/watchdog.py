"""What can go wrong while a Crazyflie flies, and is seen from the ground."""

import time

from plants.crazyflie.connection.link import Link
from plants.crazyflie.flying.bounds import Bounds
from plants.crazyflie.flying.pose import PoseFeed
from plants.crazyflie.flying.setpoint_stream import SetpointStream
from plants.crazyflie.flying.telemetry import CRASHED, FLYING, LOCKED, TUMBLED, Telemetry

BATTERY_FOR = 0.5  # s for which the voltage has to be too low: it dips with every burst of thrust
STOPPED_FOR = 1.0  # s without its motors
HEALTH_AGE_MAX = 2.0  # s
POSE_AGE_MAX = 0.5  # s
STUTTER = 0.1  # s between two looks: this process stood still, and what came meanwhile has not been read yet
STOPS = {LOCKED: "locked", CRASHED: "crashed", TUMBLED: "tumbled"}
WITHOUT_SETPOINTS = (
    "nothing can be sent; without setpoints the firmware levels out after 0.5 s, and after 2 s it stops the motors,"
    " falls, and stays locked until it is restarted"
)
ON_ITS_OWN = (
    "nothing can be sent; its planner on board flies it: if it was landing it lands, otherwise it hovers until it is"
    " reached again or its battery is empty"
)


def link_lost(why: str, *, on_its_own: bool) -> str:
    """That the link is lost, and what the drone does now."""
    return f"link lost ({why}): {ON_ITS_OWN if on_its_own else WITHOUT_SETPOINTS}"


class Watchdog:
    """Looks again and again, in flight.

    Args:
        link: To the drone.
        vitals: What the drone tells.
        stream: What the drone is told.
        bounds: What the flight keeps to.
        pose: What measures its position, if it does not do that itself.
    """

    def __init__(
        self, link: Link, vitals: Telemetry, stream: SetpointStream, bounds: Bounds, pose: PoseFeed | None
    ) -> None:
        self._link = link
        self._vitals = vitals
        self._stream = stream
        self._bounds = bounds
        self._pose = pose
        self.begin()

    def begin(self) -> None:
        """It takes off: forget what was before."""
        self._battery_fine = self._looked = self._patience = time.monotonic()
        self._flew: float | None = None

    def look(self, *, on_its_own: bool) -> str:
        """What is wrong; empty if nothing is. Without a link it matters whether the drone flies on its own."""
        now = time.monotonic()
        if now - self._looked > STUTTER + 1.0 / self._bounds.rate:
            self._patience = now + STUTTER
        self._looked = now
        return (self._body(now) or self._silence(on_its_own)) if now >= self._patience else ""

    def _body(self, now: float) -> str:
        health = self._vitals.health
        for bit, word in STOPS.items():
            if health.has(bit):
                return f"it is {word}: the firmware has stopped its motors"
        if health.has(FLYING):
            self._flew = now
        if self._flew is not None and now - self._flew > STOPPED_FOR:
            return "its motors have stopped"
        if health.battery >= self._bounds.battery_low:
            self._battery_fine = now
        if now - self._battery_fine > BATTERY_FOR:
            return f"battery {health.battery:.2f} V, at least {self._bounds.battery_low:g} V is needed"
        return ""

    def _silence(self, on_its_own: bool) -> str:
        bounds = self._bounds
        if lost := self._link.lost:
            return link_lost(lost, on_its_own=on_its_own)
        if (age := self._vitals.motion.age) > bounds.state_age_max:
            return f"its state is {age:.2f} s old, at most {bounds.state_age_max:g} s is allowed"
        if self._pose is not None and self._pose.age > POSE_AGE_MAX:
            return f"the last pose came {self._pose.age:.2f} s ago, at most {POSE_AGE_MAX:g} s is allowed"
        if (age := self._vitals.health.age) > HEALTH_AGE_MAX:
            return f"its battery was last heard of {age:.1f} s ago, at most {HEALTH_AGE_MAX:g} s is allowed"
        if (age := self._stream.command_age) > bounds.land_after:
            return f"no command for {age:.1f} s, at most {bounds.land_after:g} s is allowed"
        return ""
