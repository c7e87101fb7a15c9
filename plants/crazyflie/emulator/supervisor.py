"""Supervisor of the firmware: it decides whether the motors may run."""

import enum
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

PERIOD = 40  # ms between two updates
LEVEL_AFTER, FALL_AFTER = 500, 2000  # ms without a setpoint
FLYING_FOR = 2000  # ms after the last thrust for which the drone still counts as flying
CAN_FLY = 1 << 3  # of the bits for clients
FEED_PERIOD = 1000  # ms; longest time between two watchdog packets, once there was one


class SupervisorState(enum.Enum):
    """State of the drone as the supervisor sees it."""

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


class Observation(NamedTuple):
    """Inputs of the supervisor.

    Attributes:
        thrust: A motor runs.
        tumbled: The drone is upside down, or on its side.
        setpoint_age: Age of the last setpoint, ms.
        healthy: The drone passes its own checks.
        ready_timeout: Time for which it stays armed without taking off, ms.
        landed_timeout: Time for which it stays armed after landing, ms.
    """

    thrust: bool
    tumbled: bool
    setpoint_age: int
    healthy: bool
    ready_timeout: int
    landed_timeout: int


class Conditions(NamedTuple):
    """Conditions of transitions between states.

    Attributes:
        armed: The drone is armed.
        flying: A motor has run within the last 2 s.
        tumbled: The drone is upside down.
        healthy: The drone passes its own checks.
        late: There has been no setpoint for 0.5 s.
        silent: There has been no setpoint for 2 s.
        emergency: An emergency stop was received, or the watchdog packets have stopped.
        crashed: The drone tumbled in flight, and no recovery has been accepted since.
        ready_too_long: The drone has been armed for too long without taking off.
        landed_too_long: The drone has been armed for too long since it landed.
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

# The first condition that holds gives the next state; if none holds, the state stays.
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
    """State machine that is updated 25 times a second.

    Arming is required. The drone disarms by itself if it is armed for too long without taking off, or after landing.
    Without setpoints it levels out after 0.5 s, and after 2 s its motors stop; then, and after an emergency stop, it is
    locked until it is switched off and on. It is locked as well if setpoints end within 2 s after the motors have
    stopped on the ground, since until then it counts as flying. Upside down in flight the motors stop; once the drone
    is upright it recovers on command.

    Attributes:
        state: Present state.
        automatic: The drone arms itself whenever it can be armed, as the firmware of brushed Crazyflies does.
        armed: The drone is armed.
        tumbled: The drone was tumbled at the last update.

    Source: crazyflie-firmware (2026), documentation "Supervisor": states, conditions, arming, crash handling.
    """

    def __init__(self) -> None:
        self.state = SupervisorState.NOT_PASSED
        self.automatic = False
        self.armed = False
        self.tumbled = False
        self._crashed = False
        self._stopped = False
        self._fed_at: int | None = None
        self._last_thrust: int | None = None
        self._entered = 0

    @property
    def can_be_armed(self) -> bool:
        """Whether arming would be accepted."""
        return self.state is SupervisorState.PASSED

    @property
    def motors_may_run(self) -> bool:
        """Whether setpoints reach the motors."""
        return self.state in MOTORS_MAY_RUN

    @property
    def bits(self) -> int:
        """Bits for clients: can be armed, armed, arms itself, can fly, flying, tumbled, locked, crashed."""
        flags = (
            self.can_be_armed,
            self.armed,
            self.automatic,
            self.motors_may_run,
            self.state in (SupervisorState.FLYING, SupervisorState.LEVELLING),
            self.tumbled,
            self.state is SupervisorState.LOCKED,
            self._crashed,
        )
        return sum(1 << bit for bit, flag in enumerate(flags) if flag)

    def arm(self, wanted: bool) -> bool:
        """Arm or disarm; return whether that was accepted."""
        if wanted and not self.armed and not self.can_be_armed:
            return False
        self.armed = wanted
        return True

    def recover(self) -> bool:
        """Recover from a crash; return whether that was accepted."""
        if self._crashed and self.tumbled:
            return False
        self._crashed = False
        return True

    def stop(self) -> None:
        """Stop in an emergency: the motors stay off until the drone is switched off and on."""
        self._stopped = True

    def feed(self, now: int) -> None:
        """Feed the emergency-stop watchdog at `now`, ms. After the first time, a missing feed is an emergency."""
        self._fed_at = now

    def update(self, observation: Observation, now: int) -> None:
        """Update the state at `now`, ms."""
        if observation.thrust:
            self._last_thrust = now
        self.tumbled = observation.tumbled
        conditions = self._conditions(observation, now)
        after = next((state for holds, state in TRANSITIONS[self.state] if holds(conditions)), self.state)
        if after is not self.state:
            self.state, self._entered = after, now
            self._crashed |= after is SupervisorState.CRASHED
            self.armed &= self.motors_may_run
        elif self.automatic and self.can_be_armed:
            self.armed = True

    def _conditions(self, observation: Observation, now: int) -> Conditions:
        here = now - self._entered
        return Conditions(
            armed=self.armed,
            flying=self._last_thrust is not None and now - self._last_thrust < FLYING_FOR,
            tumbled=observation.tumbled,
            healthy=observation.healthy,
            late=observation.setpoint_age > LEVEL_AFTER,
            silent=observation.setpoint_age > FALL_AFTER,
            emergency=self._stopped or (self._fed_at is not None and now >= self._fed_at + FEED_PERIOD),
            crashed=self._crashed,
            ready_too_long=here > observation.ready_timeout,
            landed_too_long=here > observation.landed_timeout,
        )
