"""Monitoring of a Crazyflie in flight."""

import logging
import time

from plants.crazyflie.connection.link import Link
from plants.crazyflie.flying.bounds import Bounds
from plants.crazyflie.flying.pose import PoseFeed
from plants.crazyflie.flying.setpoint_stream import SetpointStream
from plants.crazyflie.flying.telemetry import CRASHED, FLYING, LOCKED, TUMBLED, Telemetry

log = logging.getLogger(__name__)

BATTERY_FOR = 0.5  # s for which the voltage has to be too low: it dips with every burst of thrust
STOPPED_FOR = 1.0  # s with stopped motors
HEALTH_AGE_MAX = 2.0  # s
POSE_AGE_MAX = 0.5  # s
STALL = 0.1  # s by which a check is late: the process was suspended, and received packets are still unread
STOPS = {LOCKED: "locked", CRASHED: "crashed", TUMBLED: "tumbled"}
WITHOUT_SETPOINTS = (
    "nothing can be sent; without setpoints the firmware levels out after 0.5 s, and after 2 s it stops the motors,"
    " falls, and stays locked until it is restarted"
)
WITH_PLANNER = (
    "nothing can be sent; its planner on board flies it: if it was landing it lands, otherwise it hovers until it is"
    " reached again or its battery is empty"
)


def link_lost(why: str, *, planner_flies: bool) -> str:
    """Return a message that the link is lost, and what the drone does now."""
    return f"link lost ({why}): {WITH_PLANNER if planner_flies else WITHOUT_SETPOINTS}"


class Watchdog:
    """Checks of a drone in flight, from its telemetry and from the ages of packets and commands.

    Args:
        link: Link to the drone.
        telemetry: Telemetry of the drone.
        setpoints: Setpoints sent to the drone.
        bounds: Limits of the flight.
        pose: External measurement of the drone's position, if there is one.
    """

    def __init__(
        self, link: Link, telemetry: Telemetry, setpoints: SetpointStream, bounds: Bounds, pose: PoseFeed | None
    ) -> None:
        self._link = link
        self._telemetry = telemetry
        self._setpoints = setpoints
        self._bounds = bounds
        self._pose = pose
        self.reset()

    def reset(self) -> None:
        """Start afresh, before a take-off."""
        self._battery_ok_at = self._checked_at = self._ready_at = time.monotonic()
        self._flying_at: float | None = None
        self._station_at: float | None = None  # last instant with an active base station; None before the first
        self._certain = False  # the variance has been small enough before
        self._lost = ""  # why the position is lost, as last logged

    def check(self, *, planner_flies: bool) -> str:
        """Return what is wrong; empty if nothing is.

        Args:
            planner_flies: The firmware's planner flies the drone, which needs no link; the message depends on it.
        """
        now = time.monotonic()
        if now - self._checked_at > STALL + 1.0 / self._bounds.rate:
            self._ready_at = now + STALL
        self._checked_at = now
        if now < self._ready_at:
            return ""
        return self._body_problem(now) or self._silence_problem(planner_flies) or self._position_problem(now)

    def _body_problem(self, now: float) -> str:
        health = self._telemetry.health
        for bit, name in STOPS.items():
            if health.has(bit):
                return f"it is {name}: the firmware has stopped its motors"
        if health.has(FLYING):
            self._flying_at = now
        if self._flying_at is not None and now - self._flying_at > STOPPED_FOR:
            return "its motors have stopped"
        if health.battery >= self._bounds.battery_low:
            self._battery_ok_at = now
        if now - self._battery_ok_at > BATTERY_FOR:
            return f"battery {health.battery:.2f} V, at least {self._bounds.battery_low:g} V is needed"
        return ""

    def _silence_problem(self, planner_flies: bool) -> str:
        bounds = self._bounds
        if lost := self._link.lost:
            return link_lost(lost, planner_flies=planner_flies)
        if (age := self._telemetry.motion.age) > bounds.state_age_max:
            return f"its state is {age:.2f} s old, at most {bounds.state_age_max:g} s is allowed"
        if self._pose is not None and self._pose.age > POSE_AGE_MAX:
            return f"the last pose came {self._pose.age:.2f} s ago, at most {POSE_AGE_MAX:g} s is allowed"
        if (age := self._telemetry.health.age) > HEALTH_AGE_MAX:
            return f"its battery was last heard of {age:.1f} s ago, at most {HEALTH_AGE_MAX:g} s is allowed"
        if (age := self._setpoints.command_age) > bounds.land_after:
            return f"no command for {age:.1f} s, at most {bounds.land_after:g} s is allowed"
        return ""

    def _position_problem(self, now: float) -> str:
        """Return why the position is lost, if the drone has to react to that; otherwise log it."""
        lost = self._position_lost(now)
        if self._bounds.position_lost == "land":
            return lost
        if lost and not self._lost:
            log.warning("it flies on, though its position is lost: %s", lost)
        self._lost = lost
        return ""

    def _position_lost(self, now: float) -> str:
        """Return why the position is not known any more; empty if it is, or never was since the take-off.

        Without measurements the estimate drifts, while it goes on to change and looks like a sound one.
        """
        health, bounds = self._telemetry.health, self._bounds
        if health.base_stations:
            self._station_at = now
        if self._station_at is not None and self._pose is None and now - self._station_at > bounds.unmeasured_after:
            dark = now - self._station_at
            return f"no base station for {dark:.1f} s, at most {bounds.unmeasured_after:g} s is allowed"
        variance = float(health.variance.max())
        if variance <= bounds.variance_max:
            self._certain = True
        elif self._certain:
            return f"variance of its position {variance:.1e} m², at most {bounds.variance_max:g} m² is allowed"
        return ""
