"""Interface of a plant, the body that an agent senses and acts on."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Pauses: TypeAlias = Iterable[float] | None


def read_only(values: npt.ArrayLike) -> Array:
    """Return a read-only float64 copy of `values`."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def nothing() -> Array:
    """Return an empty array, shape (0,)."""
    return read_only([])


@dataclass(frozen=True, slots=True)
class State:
    """Measured state of an agent's body at one instant, world frame.

    Attributes:
        position: Shape (d,), in m; d is 2 or 3, and 0 for an agent without a plant.
        velocity: Shape (d,), in m/s.
    """

    position: Array = field(default_factory=nothing)
    velocity: Array = field(default_factory=nothing)

    @property
    def vector(self) -> Array:
        """Position and velocity in one array, shape (2d,)."""
        return np.concatenate((self.position, self.velocity))


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Command of a controller to a plant, world frame. A plant follows the fields that it can track.

    Attributes:
        position: Shape (d,), in m.
        velocity: Shape (d,), in m/s.
        acceleration: Shape (d,), in m/s², held until the next setpoint. None: come to rest as fast as the body can,
            and stay.
    """

    position: Array = field(default_factory=nothing)
    velocity: Array = field(default_factory=nothing)
    acceleration: Array | None = field(default_factory=nothing)

    @classmethod
    def hold(cls, state: State) -> "Setpoint":
        """Return the setpoint that comes to rest near `state`."""
        return cls(state.position, np.zeros_like(state.velocity), None)

    @property
    def vector(self) -> Array:
        """Position, velocity and acceleration in one array, shape (3d,); NaN where there is no acceleration."""
        acceleration = np.full_like(self.velocity, np.nan) if self.acceleration is None else self.acceleration
        return np.concatenate((self.position, self.velocity, acceleration))


class Check(NamedTuple):
    """Result of one check before the take-off.

    Attributes:
        name: Name of the check, such as 'battery'.
        value: Value found, with its unit, such as '3.92 V'.
        problem: Reason why the agent must not take off; empty if there is none.
    """

    name: str
    value: str
    problem: str = ""


class Plant(ABC):
    """Body of one agent, simulated or real.

    Time is an argument, in ns since the fleet's start: a simulated plant integrates its motion up to `now`, real
    hardware ignores it. So one class serves both clocks, and a late setpoint acts late.

    The phases of a flight are `prepare`, `inspect`, `arm`, `take_off`, `settle`, `go_to_start`, then `start` and the
    steps of the run, and last `finish`. After each phase before `start` all agents of a fleet wait for each other; if
    one raises an exception, none goes on. A phase that takes real time is a generator: it yields the time, in s, until
    it is to be resumed, and the agent handles messages meanwhile. A simulated plant overrides only the phases that it
    needs; they take no time of the fleet.

    The constructor's positional parameters are filled in by name: `agent` (id), `start` (position, shape (d,), m),
    `sample_time` (s), `rng` (numpy Generator, seeded from the fleet's seed and the agent's id). Its keyword-only
    parameters are the keys of its table in a fleet file.

    Attributes:
        real: Whether it moves in the real world: a person must agree to the take-off, and time is the wall clock's.
        landing_time: Longest duration of `finish`, in s.
        own_keys: Keys of its table whose values no two agents may share; `owned` defines which values are equal.
    """

    real: ClassVar[bool] = False
    landing_time: ClassVar[float] = 0.0
    own_keys: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def owned(cls, key: str, value: object) -> object:  # noqa: ARG003
        """Return the thing that a `value` of one of `own_keys` names, equal for two values that name the same thing."""
        return value

    @classmethod
    def device(cls, key: str, value: object) -> str:  # noqa: ARG003
        """Return the name of the device that a `value` of one of `own_keys` uses, such as ``radio 0``; empty if none.

        It is a device of the computer on which the agent runs, that only one process can open.
        """
        return ""

    def prepare(self) -> Pauses:
        """Connect; nothing moves. Called once, before any other method."""

    def inspect(self) -> Pauses:
        """Inspect whether the body can fly; nothing moves. `checks` returns the findings."""

    def checks(self) -> tuple[Check, ...]:
        """Return the findings of `inspect`. If one has a problem, no agent of the fleet takes off."""
        return ()

    def arm(self) -> Pauses:
        """Make the motors ready to turn."""

    def take_off(self) -> Pauses:
        """Leave the ground."""

    def settle(self) -> Pauses:
        """Wait until the body hovers at rest."""

    def go_to_start(self) -> Pauses:
        """Fly to the start position."""

    def start(self, now: int) -> None:
        """Get ready to follow setpoints from `now` on, which is fleet time 0."""

    def resume(self, state: State, now: int) -> None:  # noqa: ARG002
        """Continue in the middle of a run after a restart of the daemon, in place of all phases but `prepare`.

        A simulated plant starts from `state`, the last that is known, and comes to rest; a real one senses where it is.
        """
        self.start(now)

    @abstractmethod
    def sense(self, now: int) -> State:
        """Return the state at `now`, in ns, read-only. `now` never decreases over the life of a plant."""

    @abstractmethod
    def act(self, setpoint: Setpoint, now: int) -> None:
        """Follow `setpoint` from `now` on, in ns."""

    def finish(self, now: int, reason: str) -> Pauses:
        """Come to rest (land, for a drone), because of `reason`.

        Called at the end of every run, however it ends, if `arm` was called before. Safe to call after a landing.
        """

    def close(self) -> None:
        """Release what `prepare` acquired. Safe to call twice, and after a failed `prepare`."""

    def emergency_stop(self) -> None:
        """Stop all motion at once. Callable from any thread, never through the agent's loop."""


class Piece(NamedTuple):
    """Piece of the path of a body: constant acceleration from `begin` until the next piece begins.

    Attributes:
        begin: Fleet time, ns.
        position: Position then, shape (d,), m.
        velocity: Velocity then, shape (d,), m/s.
        acceleration: Shape (d,), m/s².
    """

    begin: int
    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def between(cls, begin: int, state: State, end: int, position: Array) -> "Piece":
        """Return the piece that leaves `state` at `begin` and reaches `position` at `end`, ns."""
        duration = (end - begin) * 1e-9
        acceleration = 2 * (position - state.position - state.velocity * duration) / duration**2
        return cls(begin, state.position, state.velocity, acceleration)


@runtime_checkable
class KnownPath(Protocol):
    """A simulated plant whose whole path is known, not only where it is sensed.

    Its motion follows from its constructor's arguments and its setpoints alone. So what is measured of a run, such as
    the closest approach, replays the recorded setpoints on a fresh plant. The path is used only if `sense` returns the
    recorded states. A class that inherits `path` is not replayed, since what it adds may act on the world, such as
    write a file; one that may be replayed states so in its body: ``path = PointMass.path``.
    """

    def path(self, until: int) -> Iterable[Piece]:
        """Move on to `until`, ns, as `sense` does; return the pieces of the true path since the last call of a method.

        The pieces are in order; the first begins where the body was. There is none if no time has passed.
        """


class NoPlant(Plant):
    """Plant of an agent that only computes: there is nothing to sense or to move."""

    def sense(self, now: int) -> State:  # noqa: ARG002
        """Return an empty state."""
        return State()

    def act(self, setpoint: Setpoint, now: int) -> None:
        """Do nothing."""
