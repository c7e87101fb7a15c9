"""Thread that keeps a Crazyflie supplied with setpoints, and lands it when something is wrong."""

import logging
import math
import threading
import time
from collections.abc import Callable, Generator, Iterator

import numpy as np

from dcf_zenoh.errors import PlantError
from plants.crazyflie.connection.link import Link
from plants.crazyflie.connection.outbox import POLL
from plants.crazyflie.flying.bounds import Bounds, allowed_height
from plants.crazyflie.flying.pose import PoseFeed
from plants.crazyflie.flying.setpoint_stream import Point, SetpointStream
from plants.crazyflie.flying.telemetry import ARMED, FLYING, Motion, Telemetry
from plants.crazyflie.flying.watchdog import HEALTH_AGE_MAX, Watchdog

log = logging.getLogger(__name__)

CLIMB, CRUISE, DESCENT = 0.4, 0.3, 0.2  # m/s on average, under the firmware's own planner
SHORTEST = 1.5  # s; least duration of a planned manoeuvre
REPEAT_AFTER = 0.1  # s after which a command to the planner is repeated; after 2 s without any the drone would fall
HANDOVERS = 3  # further notifications that setpoints end, once the planner has a plan: nothing confirms these
RECENT = 0.1  # s; age of the last packet up to which the drone counts as reached by what is sent
ACCEPT_TIMEOUT = 3.0  # s for the planner to accept a command, and for the drone to leave the ground
LIFT_OFF = 0.05  # m above the ground
OVERTIME = 4.0  # s for a manoeuvre beyond its planned duration
REACHED, SLOW = 0.1, 0.15  # m and m/s within which the drone is at a point
LAND_BELOW = 0.01  # m below the ground: the motors stop where the plan ends, from where the drone would drop
NEAR_GROUND, STANDS_FOR = 0.06, 0.3  # m above the ground and s after which the drone counts as landed
BRAKING = 0.8  # s
SWITCHING_OFF = 3  # times that stop and disarming are sent
STOPPING = 0.5  # s for which the emergency stop is repeated

FLY, LAND, STOP = 0, 1, 2  # ranks of activities: a landing ends flying, and an emergency stop ends everything


class Autopilot:
    """Control of one flight of one drone, from the ground to the ground.

    The autopilot runs one activity at a time: a generator that is resumed `Bounds.rate` times a second on the
    autopilot's own thread, independently of the control loop. Callers start activities by methods that yield pauses, in
    s, until the activity is done, and steer the drone in between by commands to `setpoints`.

    A watchdog runs in flight. When it reports a problem, the autopilot lands the drone and stores the reason in
    `failure`; from then on it refuses to fly.

    Args:
        link: Link to the drone.
        telemetry: Telemetry of the drone.
        bounds: Limits of the flight.
        pose: External measurement of the drone's position, if there is one; the autopilot forwards it to the drone.

    Attributes:
        setpoints: Setpoints sent to the drone between manoeuvres.
        failure: What went wrong; empty if nothing did.
        airborne: The drone is in the air, as far as is known.
        planner_flies: The firmware's planner flies the drone, which continues without a link.
        ground: Height of the ground at the take-off, in m.
    """

    def __init__(self, link: Link, telemetry: Telemetry, bounds: Bounds, pose: PoseFeed | None = None) -> None:
        self._link = link
        self._telemetry = telemetry
        self._bounds = bounds
        self._pose = pose
        self.setpoints = SetpointStream(link, telemetry, bounds)
        self.failure = ""
        self.airborne = self.planner_flies = False
        self.ground = 0.0
        self._watchdog = Watchdog(link, telemetry, self.setpoints, bounds, pose)
        self._lock = threading.Lock()  # guards _rank, _activity and _done, which change together, from any thread
        self._rank = FLY
        self._activity: Iterator[None] = iter(())
        self._done = threading.Event()
        self._stop_sent = threading.Event()  # set unless an emergency stop is still being sent
        self._stop_sent.set()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="crazyflie-autopilot", daemon=True)

    def start(self) -> None:
        """Start the thread. The drone stands, or hovers where an earlier program left it."""
        self.airborne = self._telemetry.health.has(FLYING) and self._height > REACHED
        self.setpoints.halt()
        self._thread.start()

    def close(self) -> None:
        """End the thread, after an emergency stop has been sent often enough."""
        self._stop_sent.wait(2 * STOPPING)
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def take_off(self, height: float) -> Iterator[float]:
        """Climb straight up to `height`, in m, and hover there; pauses, in s, until it does."""
        return self._execute(FLY, lambda done: self._climb(height, done))

    def go_to(self, point: Point) -> Iterator[float]:
        """Fly to a point in a straight line, and hover there; pauses, in s, until it does."""
        return self._execute(FLY, lambda done: self._travel(point, done))

    def land(self) -> Iterator[float]:
        """Brake, descend and stop the motors, or wait for the end of a landing that runs; pauses, in s, until then."""
        return self._execute(LAND, self._land_and_disarm)

    def stop(self) -> None:
        """Stop the motors at once. Safe on any thread, even while other threads wait for the link."""
        self._stop_sent.clear()
        self.failure = self.failure or "emergency stop"
        self.airborne = False  # before callers are released: the drone falls, and there is nothing to land
        self._switch_to(STOP, _no_activity)
        thread = threading.Thread(target=self._cut_motors, name="emergency-stop", daemon=True)
        thread.start()
        thread.join(POLL)  # long enough for the first packet, unless the link blocks

    def _execute(self, rank: int, begin: Callable[[threading.Event], Iterator[None]]) -> Iterator[float]:
        """Run an activity; pauses, in s, until it is done.

        Raises:
            PlantError: The activity is a flight, and a landing or stop ended it.
        """
        done = self._switch_to(rank, begin)
        while not done.is_set() and self._thread.is_alive() and not (rank == FLY and self._rank > FLY):
            yield POLL
        if rank == FLY and self._rank > FLY:
            raise PlantError(self.failure or "it is to land")

    def _switch_to(self, rank: int, begin: Callable[[threading.Event], Iterator[None]]) -> threading.Event:
        """Replace the activity, unless the present one has a higher rank.

        Returns:
            The event that is set when the activity now running is done.
        """
        with self._lock:
            if rank > self._rank or rank == self._rank == FLY:
                before, self._rank, self._done = self._done, rank, threading.Event()
                self._activity = begin(self._done)
                before.set()  # releases callers that wait for the replaced activity
            return self._done

    def _run(self) -> None:
        period = 1.0 / self._bounds.rate
        due = time.monotonic() + period
        while not self._closed.wait(max(0.0, due - time.monotonic())):
            due = max(due + period, time.monotonic())
            self.work()

    def work(self) -> None:
        """Do what is due in one period: forward the pose, run the watchdog, and resume the activity.

        The thread calls this; without the thread, such as in model time, a caller does, `Bounds.rate` times a second.
        """
        try:
            if self._pose is not None:
                self._pose.forward(self._link)
            if self.airborne and self._rank == FLY:
                problem = self._watchdog.check(planner_flies=self.planner_flies)
                if problem:
                    self._abort(problem)
            next(self._activity, None)
        except Exception as error:  # the drone must not stay in the air, whatever fails here
            log.exception("the pilot failed")
            self._abort(f"the pilot failed: {type(error).__name__}: {error}")

    def _abort(self, why: str) -> None:
        """Land, for the reason `why`."""
        log.warning("%s", why)
        self.failure = self.failure or why
        self._switch_to(LAND, self._land_and_disarm)

    def _climb(self, height: float, done: threading.Event) -> Iterator[None]:
        x, y, self.ground = (float(component) for component in self._telemetry.motion.position)
        plan = max(SHORTEST, (height - self.ground) / CLIMB)
        self._watchdog.reset()
        self.airborne = True

        def command() -> None:  # the planner ignores it while a take-off runs
            if not self._telemetry.health.has(ARMED):
                self._link.arm(True)
            self._link.high_level.takeoff(height, plan, yaw=None)

        until = time.monotonic() + ACCEPT_TIMEOUT
        self._link.commander.send_notify_setpoint_stop()  # first: the climb begins when the drone executes it
        yield from self._command_planner(command, until)
        while self._height < LIFT_OFF and time.monotonic() < until:
            yield
        if self._height > LIFT_OFF:
            yield from self._hover_at(Point(x, y, height), time.monotonic() + plan, "take-off", done)
        else:
            self.airborne = False
            self._abort(f"it did not take off: within {ACCEPT_TIMEOUT:g} s it rose by {self._height:.2f} m")

    def _travel(self, point: Point, done: threading.Event) -> Iterator[None]:
        point = point._replace(z=allowed_height(point.z))
        far = _distance(self._telemetry.motion, point)
        plan = max(SHORTEST, far / CRUISE) if far > REACHED else 0.0
        begun = time.monotonic()
        if plan:
            heading = self._telemetry.motion.yaw
            begun = yield from self._command_planner(
                lambda: self._link.high_level.go_to(*point, heading, plan), begun + ACCEPT_TIMEOUT
            )
        yield from self._hover_at(point, begun + plan, "going to its start", done)

    def _land_and_disarm(self, done: threading.Event) -> Iterator[None]:
        if self.airborne:
            motion = self._telemetry.motion
            if float(np.linalg.norm(motion.velocity)) > SLOW and motion.age < self._bounds.state_age_max:
                self.setpoints.halt()
                yield from self._hover(time.monotonic() + BRAKING)
            yield from self._descend()
        for _ in range(0 if self.airborne else SWITCHING_OFF):
            self._link.high_level.stop()
            self._link.arm(False)
            yield from _pause(REPEAT_AFTER)
        done.set()

    def _descend(self) -> Iterator[None]:
        plan = max(SHORTEST, self._height / DESCENT)
        begun = yield from self._command_planner(
            lambda: self._link.high_level.land(
                self.ground - LAND_BELOW, plan, yaw=None
            ),  # ignored while a landing runs
            time.monotonic() + ACCEPT_TIMEOUT,
        )
        until = begun + plan + OVERTIME
        stood = math.inf
        while (now := time.monotonic()) < until and now - stood < STANDS_FOR:
            yield
            motion = self._telemetry.motion
            slow = self._height < NEAR_GROUND and float(np.linalg.norm(motion.velocity)) < SLOW
            stood = min(stood, now) if slow and motion.age < self._bounds.state_age_max else math.inf
        health = self._telemetry.health
        self.airborne = not (stood < math.inf or (health.age < HEALTH_AGE_MAX and not health.has(FLYING)))
        if self.airborne:
            self.failure = self.failure or f"it was not seen to land within {plan + OVERTIME:.1f} s"

    def _command_planner(self, command: Callable[[], None], until: float) -> Generator[None, None, float]:
        """Send a command to the firmware's planner until it is accepted, or until an instant, in s.

        The command comes before the notification that setpoints end. A planner without a plan executes a null setpoint:
        in the other order the motors are off from the notification until the command, for as long as the radio is
        silent. The planner starts at the drone in this order too, since its position is refreshed while it is idle.

        Returns:
            The instant at which the planner had accepted it, or `until`, monotonic clock, in s.
        """
        began = time.monotonic()
        while not self._link.accepted_since(began) and time.monotonic() < until:
            command()
            self._link.commander.send_notify_setpoint_stop()
            yield from _pause(REPEAT_AFTER)
        accepted = time.monotonic()
        self.planner_flies |= self._link.accepted_since(began)
        for _ in range(HANDOVERS if self._link.accepted_since(began) else 0):
            self._link.commander.send_notify_setpoint_stop()
            yield from _pause(REPEAT_AFTER)
        return accepted

    def _hover_at(self, point: Point, planned: float, what: str, done: threading.Event) -> Iterator[None]:
        """Leave control to the firmware's planner until `planned`, then hover at `point`; abort if not reached."""
        while time.monotonic() < planned:
            yield
        self.setpoints.keep_to(point)
        while not _is_at(self._telemetry.motion, point):
            if time.monotonic() > planned + OVERTIME:
                there = np.round(self._telemetry.motion.position, 2).tolist()
                self._abort(f"{what}: expected to hover at {list(point)} m, came to {there} m")
                return
            self._send()
            yield
        done.set()
        yield from self._hover(math.inf)

    def _hover(self, until: float) -> Iterator[None]:
        while time.monotonic() < until:
            self._send()
            yield

    def _send(self) -> None:
        """Send one setpoint, which takes over from the firmware's planner if the drone receives it."""
        self.setpoints.send()
        self.planner_flies &= self._link.silence > RECENT

    def _cut_motors(self) -> None:
        until = time.monotonic() + STOPPING
        while time.monotonic() < until:
            self._link.emergency_stop()
            self.airborne = False
            time.sleep(1.0 / self._bounds.rate)  # between two packets
        self._stop_sent.set()

    @property
    def _height(self) -> float:
        return float(self._telemetry.motion.position[2]) - self.ground


def _pause(duration: float) -> Iterator[None]:
    until = time.monotonic() + duration
    while time.monotonic() < until:
        yield


def _no_activity(done: threading.Event) -> Iterator[None]:
    done.set()
    return iter(())


def _distance(motion: Motion, point: Point) -> float:
    return float(np.linalg.norm(motion.position - np.array(point)))


def _is_at(motion: Motion, point: Point) -> bool:
    return _distance(motion, point) < REACHED and float(np.linalg.norm(motion.velocity)) < SLOW
