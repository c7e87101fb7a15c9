"""The supervisor: whether the motors may run, and what happens when something is wrong."""

import enum
from typing import NamedTuple

PERIOD = 40  # ms between two looks
LEVEL_AFTER, FALL_AFTER = 500, 2000  # ms without a setpoint
FLYING_FOR = 2000  # ms after the last thrust in which it still counts as flying
FED_EVERY = 1000  # ms; the longest time between two signs of life, once there was one


class State(enum.Enum):
    """As in the firmware; what is in quotes is for people."""

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


MOTORS_MAY_RUN = (State.READY, State.FLYING, State.LANDED, State.LEVELLING)


class Conditions(NamedTuple):
    """What the supervisor looks at.

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


class Supervisor:
    """A state machine that looks at the drone 25 times a second.

    Arming is required. It disarms by itself where it is armed for too long without taking off, or after landing. Without
    setpoints it levels out after 0.5 s and lets the drone fall after 2 s; then, and after an emergency stop, it
    is locked until it is switched off and on. Upside down in flight it stops the motors, and can be told to recover once
    it is upright.

    Attributes:
        state: What it thinks the drone does.
        armed: It has been armed.
        tumbled: At the last look.

    Source: crazyflie-firmware, documentation "Supervisor" with states, conditions, arming and crash handling.
    """

    def __init__(self) -> None:
        self.state = State.NOT_PASSED
        self.armed = False
        self.tumbled = False
        self._healthy = True
        self._crashed = False
        self._emergency = False
        self._fed: int | None = None
        self._last_thrust: int | None = None
        self._entered = 0

    @property
    def can_be_armed(self) -> bool:
        """Whether it would accept arming."""
        return self.state is State.PASSED

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
            self.state in (State.FLYING, State.LEVELLING),
            self.tumbled,
            self.state is State.LOCKED,
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
        self._emergency = True

    def feed(self, now: int) -> None:
        """A sign of life at `now`, ms. From the first one on, its absence is an emergency."""
        self._fed = now

    def look(self, seen: Conditions, now: int) -> None:
        """Decide anew at `now`, ms."""
        if seen.thrust:
            self._last_thrust = now
        self.tumbled = seen.tumbled
        after = self._next(seen, now)
        if after is not self.state:
            self.state, self._entered = after, now
            self._crashed |= after is State.CRASHED
            self.armed &= self.motors_may_run

    def _next(self, seen: Conditions, now: int) -> State:  # noqa: PLR0911 - one line per transition
        state, age = self.state, seen.setpoint_age
        starved = self._fed is not None and now >= self._fed + FED_EVERY
        emergency = self._emergency or starved
        flying = self._last_thrust is not None and now - self._last_thrust < FLYING_FOR
        if state is State.FREE_FALL:
            return State.LOCKED
        if state is State.CRASHED:
            if emergency:
                return State.LOCKED
            return State.CRASHED if self._crashed or seen.tumbled else State.NOT_PASSED
        if state is State.LOCKED:
            return State.LOCKED
        if emergency and state is not State.LANDED and state is not State.RESET:
            return State.FREE_FALL
        if state is State.NOT_PASSED:
            return State.PASSED if seen.healthy and not seen.tumbled else state
        if state is State.PASSED:
            if seen.tumbled or not seen.healthy:
                return State.NOT_PASSED
            return State.READY if self.armed else state
        if state is State.READY:
            if seen.tumbled or not self.armed or now - self._entered > seen.ready_timeout:
                return State.NOT_PASSED
            return State.FLYING if flying else state
        if state is State.FLYING:
            if age > FALL_AFTER:
                return State.FREE_FALL
            if seen.tumbled:
                return State.CRASHED
            if not self.armed:
                return State.RESET
            if age > LEVEL_AFTER:
                return State.LEVELLING
            return state if flying else State.LANDED
        if state is State.LEVELLING:
            if age > FALL_AFTER or seen.tumbled:
                return State.FREE_FALL
            return state if age > LEVEL_AFTER else State.FLYING
        if state is State.LANDED:
            if not self.armed or now - self._entered > seen.landed_timeout:
                return State.RESET
            return State.FLYING if flying else state
        return State.NOT_PASSED  # after RESET
