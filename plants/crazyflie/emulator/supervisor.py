"""The supervisor: whether the motors may run, and what happens when something is wrong."""

import enum
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

PERIOD = 40  # ms between two looks
LEVEL_AFTER, FALL_AFTER = 500, 2000  # ms without a setpoint
FLYING_FOR = 2000  # ms after the last thrust in which it still counts as flying
FED_EVERY = 1000  # ms; the longest time between two signs of life, once there was one


class SupervisorState(enum.Enum):
    """What the supervisor thinks the drone does."""

    NOT_PASSED = "checks not passed"
    PASSED = "checks passed"
    READY = "ready to fly"
    FLYING = "flying"
    LANDED = "landed"
    RESET = "reset"
    LEVELLING = "levelling out"
    FREE_FALL = "free fall"
    LOCKED = "locked"
    CRASHED = "crashed"


MOTORS_MAY_RUN = (SupervisorState.READY, SupervisorState.FLYING, SupervisorState.LANDED, SupervisorState.LEVELLING)


class Look(NamedTuple):
    """What the supervisor is shown.

    Attributes:
        thrust: A motor runs.
        tumbled: The drone is upside down, or on its side.
        setpoint_age: ms.
        healthy: It passes its own checks.
        ready_timeout: ms that it stays armed without taking off.
        landed_timeout: ms that it stays armed after landing.
    """

    thrust: bool
    tumbled: bool
    setpoint_age: int
    healthy: bool
    ready_timeout: int
    landed_timeout: int


class Conditions(NamedTuple):
    """What decides about the next state.

    Attributes:
        armed: It is.
        flying: A motor has run within 2 s.
        tumbled: It is upside down.
        healthy: It passes its own checks.
        late: There has been no setpoint for 0.5 s.
        silent: There has been no setpoint for 2 s.
        emergency: It has been stopped, or its signs of life have stopped.
        crashed: It tumbled in flight, and has not been told to recover.
        ready_too_long: It has been armed for too long without taking off.
        landed_too_long: It has been armed for too long since it landed.
    """

    armed: bool
    flying: bool
    tumbled: bool
    healthy: bool
    late: bool
    silent: bool
    emergency: bool
    crashed: bool
    ready_too_long: bool
    landed_too_long: bool


Transition: TypeAlias = tuple[Callable[[Conditions], bool], SupervisorState]

# The first condition that holds leads on; if none does, the state stays.
TRANSITIONS: dict[SupervisorState, tuple[Transition, ...]] = {
    SupervisorState.NOT_PASSED: (
        (lambda c: c.emergency, SupervisorState.FREE_FALL),
        (lambda c: c.healthy and not c.tumbled, SupervisorState.PASSED),
    ),
    SupervisorState.PASSED: (
        (lambda c: c.emergency, SupervisorState.FREE_FALL),
        (lambda c: c.tumbled or not c.healthy, SupervisorState.NOT_PASSED),
        (lambda c: c.armed, SupervisorState.READY),
    ),
    SupervisorState.READY: (
        (lambda c: c.emergency, SupervisorState.FREE_FALL),
        (lambda c: c.tumbled or not c.armed or c.ready_too_long, SupervisorState.NOT_PASSED),
        (lambda c: c.flying, SupervisorState.FLYING),
    ),
    SupervisorState.FLYING: (
        (lambda c: c.silent or c.emergency, SupervisorState.FREE_FALL),
        (lambda c: c.tumbled, SupervisorState.CRASHED),
        (lambda c: not c.armed, SupervisorState.RESET),
        (lambda c: c.late, SupervisorState.LEVELLING),
        (lambda c: not c.flying, SupervisorState.LANDED),
    ),
    SupervisorState.LEVELLING: (
        (lambda c: c.silent or c.emergency or c.tumbled, SupervisorState.FREE_FALL),
        (lambda c: not c.late, SupervisorState.FLYING),
    ),
    SupervisorState.LANDED: (
        (lambda c: not c.armed or c.landed_too_long, SupervisorState.RESET),
        (lambda c: c.flying, SupervisorState.FLYING),
    ),
    SupervisorState.RESET: ((lambda _: True, SupervisorState.NOT_PASSED),),
    SupervisorState.FREE_FALL: ((lambda _: True, SupervisorState.LOCKED),),
    SupervisorState.LOCKED: (),
    SupervisorState.CRASHED: (
        (lambda c: not c.crashed and not c.tumbled, SupervisorState.NOT_PASSED),
        (lambda c: c.emergency, SupervisorState.LOCKED),
    ),
}


class FirmwareSupervisor:
    """A state machine that looks at the drone 25 times a second.

    Arming is required. It disarms by itself where it is armed for too long without taking off, or after landing.
    Without setpoints it levels out after 0.5 s, and after 2 s it lets the drone fall; then, and after an emergency
    stop, it is locked until it is switched off and on. Whoever stops sending within 2 s after the motors have stopped
    on the ground finds it locked as well, for until then it counts as flying. Upside down in flight it stops the
    motors, and it recovers when it is told to, once it is upright.

    Attributes:
        state: What it thinks the drone does.
        armed: It has been armed.
        tumbled: At the last look.

    Source: crazyflie-firmware (2026), documentation "Supervisor": states, conditions, arming, crash handling.
    """

    def __init__(self) -> None:
        self.state = SupervisorState.NOT_PASSED
        self.armed = False
        self.tumbled = False
        self._crashed = False
        self._stopped = False
        self._fed: int | None = None
        self._last_thrust: int | None = None
        self._entered = 0

    @property
    def can_be_armed(self) -> bool:
        """Whether it would accept arming."""
        return self.state is SupervisorState.PASSED

    @property
    def motors_may_run(self) -> bool:
        """Whether setpoints reach the motors."""
        return self.state in MOTORS_MAY_RUN

    @property
    def bits(self) -> int:
        """What clients are told: can be armed, armed, -, can fly, flying, tumbled, locked, crashed."""
        flags = (
            self.can_be_armed,
            self.armed,
            False,
            self.motors_may_run,
            self.state in (SupervisorState.FLYING, SupervisorState.LEVELLING),
            self.tumbled,
            self.state is SupervisorState.LOCKED,
            self._crashed,
        )
        return sum(1 << bit for bit, flag in enumerate(flags) if flag)

    def arm(self, wanted: bool) -> bool:
        """Arm or disarm; whether that was accepted."""
        if wanted and not self.armed and not self.can_be_armed:
            return False
        self.armed = wanted
        return True

    def recover(self) -> bool:
        """Forget a crash; whether that was accepted."""
        if self._crashed and self.tumbled:
            return False
        self._crashed = False
        return True

    def stop(self) -> None:
        """Emergency: no motor turns again until it is switched off and on."""
        self._stopped = True

    def feed(self, now: int) -> None:
        """A sign of life at `now`, ms. From the first one on, its absence is an emergency."""
        self._fed = now

    def look(self, seen: Look, now: int) -> None:
        """Decide anew at `now`, ms."""
        if seen.thrust:
            self._last_thrust = now
        self.tumbled = seen.tumbled
        conditions = self._conditions(seen, now)
        after = next((state for holds, state in TRANSITIONS[self.state] if holds(conditions)), self.state)
        if after is not self.state:
            self.state, self._entered = after, now
            self._crashed |= after is SupervisorState.CRASHED
            self.armed &= self.motors_may_run

    def _conditions(self, seen: Look, now: int) -> Conditions:
        here = now - self._entered
        return Conditions(
            armed=self.armed,
            flying=self._last_thrust is not None and now - self._last_thrust < FLYING_FOR,
            tumbled=seen.tumbled,
            healthy=seen.healthy,
            late=seen.setpoint_age > LEVEL_AFTER,
            silent=seen.setpoint_age > FALL_AFTER,
            emergency=self._stopped or (self._fed is not None and now >= self._fed + FED_EVERY),
            crashed=self._crashed,
            ready_too_long=here > seen.ready_timeout,
            landed_too_long=here > seen.landed_timeout,
        )
