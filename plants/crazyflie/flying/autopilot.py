"""Who flies a Crazyflie: a thread that never leaves it without setpoints, and lands it when something is wrong."""

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np

from dcf_zenoh.errors import PlantError
from plants.crazyflie.connection.link import Link
from plants.crazyflie.connection.outbox import LOOK
from plants.crazyflie.flying.bounds import Bounds, allowed_height
from plants.crazyflie.flying.pose import PoseFeed
from plants.crazyflie.flying.setpoint_stream import Point, SetpointStream
from plants.crazyflie.flying.telemetry import ARMED, FLYING, Motion, Telemetry
from plants.crazyflie.flying.watchdog import HEALTH_AGE_MAX, Watchdog

log = logging.getLogger(__name__)

CLIMB, CRUISE, SINK = 0.4, 0.3, 0.2  # m/s on average, under the firmware's own planner
SHORTEST = 1.5  # s for a planned manoeuvre
AGAIN = 0.1  # s until an order that was not accepted is repeated; without any, it would fall after 2 s
HEARD = 0.1  # s since anything came: what is sent is heard
PATIENCE = 3.0  # s until an order has to be accepted, and it has to have left the ground
LIFTED = 0.05  # m above the ground
OVERTIME = 4.0  # s for a manoeuvre beyond its plan
REACHED, SLOW = 0.1, 0.15  # m and m/s: it is at a point
NEAR_GROUND, STANDS_FOR = 0.06, 0.3  # m above it, and s: it stands
BRAKING = 0.8  # s
SWITCHING_OFF = 3  # times that is repeated
STOPPING = 0.5  # s for which the emergency stop is repeated

FLY, LAND, STOP = 0, 1, 2  # who lands does not fly on, and a stop is final


class Autopilot:
    """Flies one drone, once: from the ground to the ground.

    What it does is one activity at a time, a generator that is resumed `Bounds.rate` times a second on the pilot's own
    thread, whatever the control loop does meanwhile. Others give the orders: methods that are generators of pauses, in
    s, until the order is carried out; and commands to its `stream`, which say where to fly in between.

    It watches. When something is wrong it lands and says why in `failure`; orders to fly are then refused.

    Args:
        link: To the drone.
        vitals: What the drone tells.
        bounds: What the flight keeps to.
        pose: What measures its position, if it does not do that itself; the pilot hands it on.

    Attributes:
        stream: What the drone is told in between manoeuvres.
        failure: What went wrong; empty if nothing did.
        airborne: It is in the air, as far as one knows.
        on_its_own: The firmware's planner flies it, and does so without a link as well.
        ground: Height at which it stood when it took off, in m.
    """

    def __init__(self, link: Link, vitals: Telemetry, bounds: Bounds, pose: PoseFeed | None = None) -> None:
        self._link = link
        self._vitals = vitals
        self._bounds = bounds
        self._pose = pose
        self.stream = SetpointStream(link, vitals, bounds)
        self.failure = ""
        self.airborne = self.on_its_own = False
        self.ground = 0.0
        self._watch = Watchdog(link, vitals, self.stream, bounds, pose)
        self._lock = threading.Lock()  # guards _rank, _activity and _done, which change together, from any thread
        self._rank = FLY
        self._activity: Iterator[None] = iter(())
        self._done = threading.Event()
        self._told = threading.Event()  # of an emergency stop, often enough, if there is one
        self._told.set()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="crazyflie-pilot", daemon=True)

    def start(self) -> None:
        """Begin to watch. The drone stands, or hovers where somebody left it."""
        self.airborne = self._vitals.health.has(FLYING) and self._height > REACHED
        self.stream.halt()
        self._thread.start()

    def end(self) -> None:
        """No more setpoints, and the last word of an emergency stop is said."""
        self._told.wait(2 * STOPPING)
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(1.0)

    def take_off(self, height: float) -> Iterator[float]:
        """Climb straight up to `height`, in m, and hover there."""
        return self._carry_out(FLY, lambda done: self._climb(height, done))

    def go_to(self, point: Point) -> Iterator[float]:
        """Fly to a point in a straight line, and hover there."""
        return self._carry_out(FLY, lambda done: self._travel(point, done))

    def land(self) -> Iterator[float]:
        """Brake, sink, stop the motors. If it is landing by itself, wait until it is through with that."""
        return self._carry_out(LAND, self._descend)

    def stop(self) -> None:
        """Stop the motors at once; from any thread, even if others wait for the link."""
        self._told.clear()
        self.failure = self.failure or "emergency stop"
        self.airborne = False  # before others hear of it: it falls, and nothing lands it
        self._begin(STOP, _nothing)
        thread = threading.Thread(target=self._cut_motors, name="emergency-stop", daemon=True)
        thread.start()
        thread.join(LOOK)  # unless the link is stuck, the first packet is out by then

    def _carry_out(self, rank: int, begin: Callable[[threading.Event], Iterator[None]]) -> Iterator[float]:
        """Have an activity carried out.

        Raises:
            PlantError: It was to fly, and that was broken off.
        """
        done = self._begin(rank, begin)
        while not done.is_set() and self._thread.is_alive() and not (rank == FLY and self._rank > FLY):
            yield LOOK
        if rank == FLY and self._rank > FLY:
            raise PlantError(self.failure or "it is to land")

    def _begin(self, rank: int, begin: Callable[[threading.Event], Iterator[None]]) -> threading.Event:
        """Change the activity, unless that of now is more important; what will be set when it is through."""
        with self._lock:
            if rank > self._rank or rank == self._rank == FLY:
                before, self._rank, self._done = self._done, rank, threading.Event()
                self._activity = begin(self._done)
                before.set()  # nobody waits for what will not be carried out
            return self._done

    def _run(self) -> None:
        period = 1.0 / self._bounds.rate
        due = time.monotonic() + period
        while not self._ended.wait(max(0.0, due - time.monotonic())):
            due = max(due + period, time.monotonic())
            try:
                if self._pose is not None:
                    self._pose.forward(self._link)
                if self.airborne and self._rank == FLY and (trouble := self._watch.look(on_its_own=self.on_its_own)):
                    self._give_up(trouble)
                next(self._activity, None)
            except Exception as error:  # whatever it is, the drone must not stay in the air
                log.exception("the pilot failed")
                self._give_up(f"the pilot failed: {type(error).__name__}: {error}")

    def _give_up(self, why: str) -> None:
        """Land, because of `why`."""
        log.warning("%s", why)
        self.failure = self.failure or why
        self._begin(LAND, self._descend)

    def _climb(self, height: float, done: threading.Event) -> Iterator[None]:
        x, y, self.ground = (float(component) for component in self._vitals.motion.position)
        plan = max(SHORTEST, (height - self.ground) / CLIMB)
        self._watch.begin()
        self.airborne = True

        def order() -> None:  # the planner ignores it while it is under way
            if not self._vitals.health.has(ARMED):
                self._link.arm(True)
            self._link.high_level.takeoff(height, plan, yaw=None)

        until = time.monotonic() + PATIENCE
        yield from self._insist(order, until)
        while self._height < LIFTED and time.monotonic() < until:
            yield
        if self._height > LIFTED:
            yield from self._arrive(Point(x, y, height), time.monotonic() + plan, "take-off", done)
        else:
            self.airborne = False
            self._give_up(f"it did not take off: within {PATIENCE:g} s it rose by {self._height:.2f} m")

    def _travel(self, point: Point, done: threading.Event) -> Iterator[None]:
        point = point._replace(z=allowed_height(point.z))
        far = _distance(self._vitals.motion, point)
        plan = max(SHORTEST, far / CRUISE) if far > REACHED else 0.0
        if plan:
            heading = self._vitals.motion.yaw
            yield from self._insist(
                lambda: self._link.high_level.go_to(*point, heading, plan), time.monotonic() + PATIENCE
            )
        yield from self._arrive(point, time.monotonic() + plan, "going to its start", done)

    def _descend(self, done: threading.Event) -> Iterator[None]:
        if self.airborne:
            motion = self._vitals.motion
            if float(np.linalg.norm(motion.velocity)) > SLOW and motion.age < self._bounds.state_age_max:
                self.stream.halt()
                yield from self._hover(time.monotonic() + BRAKING)
            yield from self._sink()
        for _ in range(0 if self.airborne else SWITCHING_OFF):
            self._link.high_level.stop()
            self._link.arm(False)
            yield from _pause(AGAIN)
        done.set()

    def _sink(self) -> Iterator[None]:
        plan = max(SHORTEST, self._height / SINK)
        yield from self._insist(
            lambda: self._link.high_level.land(self.ground, plan, yaw=None),  # ignored while it is under way
            time.monotonic() + PATIENCE,
        )
        until = time.monotonic() + plan + OVERTIME
        stood = math.inf
        while (now := time.monotonic()) < until and now - stood < STANDS_FOR:
            yield
            motion = self._vitals.motion
            slow = self._height < NEAR_GROUND and float(np.linalg.norm(motion.velocity)) < SLOW
            stood = min(stood, now) if slow and motion.age < self._bounds.state_age_max else math.inf
        health = self._vitals.health
        self.airborne = not (stood < math.inf or (health.age < HEALTH_AGE_MAX and not health.has(FLYING)))
        if self.airborne:
            self.failure = self.failure or f"it was not seen to land within {plan + OVERTIME:.1f} s"

    def _insist(self, order: Callable[[], None], until: float) -> Iterator[None]:
        """Give an order to the firmware's planner until it is accepted, or until an instant, in s."""
        began = time.monotonic()
        while not self._link.accepted_since(began) and time.monotonic() < until:
            self._link.commander.send_notify_setpoint_stop()  # first: then the planner begins where the drone is
            order()
            yield from _pause(AGAIN)
        self.on_its_own |= self._link.accepted_since(began)

    def _arrive(self, point: Point, planned: float, what: str, done: threading.Event) -> Iterator[None]:
        """Leave it to the firmware's planner until an instant, then hover at `point`: soon it has to be there."""
        while time.monotonic() < planned:
            yield
        self.stream.keep_to(point)
        while not _is_at(self._vitals.motion, point):
            if time.monotonic() > planned + OVERTIME:
                there = np.round(self._vitals.motion.position, 2).tolist()
                self._give_up(f"{what}: expected to hover at {list(point)} m, came to {there} m")
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
        """One setpoint, which takes over from the firmware's planner if it is heard."""
        self.stream.send()
        self.on_its_own &= self._link.silence > HEARD

    def _cut_motors(self) -> None:
        until = time.monotonic() + STOPPING
        while time.monotonic() < until:
            self._link.emergency_stop()
            self.airborne = False
            time.sleep(1.0 / self._bounds.rate)  # between two packets
        self._told.set()

    @property
    def _height(self) -> float:
        return float(self._vitals.motion.position[2]) - self.ground


def _pause(duration: float) -> Iterator[None]:
    until = time.monotonic() + duration
    while time.monotonic() < until:
        yield


def _nothing(done: threading.Event) -> Iterator[None]:
    done.set()
    return iter(())


def _distance(motion: Motion, point: Point) -> float:
    return float(np.linalg.norm(motion.position - np.array(point)))


def _is_at(motion: Motion, point: Point) -> bool:
    return _distance(motion, point) < REACHED and float(np.linalg.norm(motion.velocity)) < SLOW
