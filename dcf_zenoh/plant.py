"""What a plant is: the body an agent senses and acts on."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Pauses: TypeAlias = Iterable[float] | None


def read_only(values: npt.ArrayLike) -> Array:
    """A float64 copy of `values` that nobody can change."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def nothing() -> Array:
    """An array without entries."""
    return read_only([])


@dataclass(frozen=True, slots=True)
class State:
    """What an agent knows of its own body at one instant, world frame.

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
    """What a controller asks of a plant, world frame. A plant follows the fields that it can track.

    Attributes:
        position: Shape (d,), in m.
        velocity: Shape (d,), in m/s.
        acceleration: Shape (d,), in m/s², held until the next setpoint. None means: come to rest as fast
            as the body can, and stay.
    """

    position: Array = field(default_factory=nothing)
    velocity: Array = field(default_factory=nothing)
    acceleration: Array | None = field(default_factory=nothing)

    @classmethod
    def hold(cls, state: State) -> "Setpoint":
        """Come to rest near where `state` is."""
        return cls(state.position, np.zeros_like(state.velocity), None)

    @property
    def vector(self) -> Array:
        """Position, velocity and acceleration in one array, shape (3d,); NaN where there is no acceleration."""
        acceleration = np.full_like(self.velocity, np.nan) if self.acceleration is None else self.acceleration
        return np.concatenate((self.position, self.velocity, acceleration))


class Check(NamedTuple):
    """One thing that was looked at before the take-off.

    Attributes:
        name: Such as 'battery'.
        value: What was found, with its unit: '3.92 V'.
        problem: What is wrong with it; empty if nothing is.
    """

    name: str
    value: str
    problem: str = ""


class Plant(ABC):
    """The body of one agent, simulated or real.

    Time is an argument, in ns since the fleet's start: a simulated plant integrates itself up to `now`, real
    hardware ignores it. So one class serves both clocks, and a setpoint that arrives late acts late.

    A flight has phases: `prepare`, `inspect`, `arm`, `take_off`, `settle`, `go_to_start`, then `start` and the steps of
    the run, last `finish`. After each phase before the start the agents of a fleet wait for each other, and where one
    of them raises an exception, nobody goes on. A phase that takes real time is a generator: it yields how long to
    wait, in s, until it wants to look again, and the agent stays within reach meanwhile. A simulated plant leaves out
    what it does not need, and what it does takes no time of the fleet.

    A constructor's positional parameters are filled in by name from what the framework knows of the agent:
    `agent` (id), `start` (position, shape (d,), m), `sample_time` (s), `rng` (numpy Generator, seeded from the
    fleet's seed and the agent's id). Its keyword-only parameters are the keys of its table in a fleet file.

    Attributes:
        real: It moves in the real world: a person has to agree to the take-off, and time is that of the wall clock.
        landing_time: Longest time that `finish` takes, s.
        own_keys: Keys of its table whose values no two agents may share; `owned` says which values are the same.
    """

    real: ClassVar[bool] = False
    landing_time: ClassVar[float] = 0.0
    own_keys: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def owned(cls, key: str, value: object) -> object:  # noqa: ARG003
        """What is taken by a `value` of one of `own_keys`; equal for two values that mean the same thing."""
        return value

    def prepare(self) -> Pauses:
        """Connect; nothing moves. Called once, before any other method."""

    def inspect(self) -> Pauses:
        """Find out whether it can fly; nothing moves. What was found is told by `checks`."""

    def checks(self) -> tuple[Check, ...]:
        """What `inspect` has found. Where there is a problem, nobody takes off."""
        return ()

    def arm(self) -> Pauses:
        """Make the motors ready to turn."""

    def take_off(self) -> Pauses:
        """Leave the ground."""

    def settle(self) -> Pauses:
        """Wait until it hovers still."""

    def go_to_start(self) -> Pauses:
        """Fly to the start position."""

    def start(self, now: int) -> None:
        """Get ready to follow setpoints from `now` on, which is fleet time 0."""

    def resume(self, state: State, now: int) -> None:  # noqa: ARG002
        """Take over in the middle of a run, in place of all phases but `prepare`: the daemon was started again.

        A simulated plant goes on from the last `state` that is known, and comes to rest; a real one senses where it is.
        """
        self.start(now)

    @abstractmethod
    def sense(self, now: int) -> State:
        """The state at `now`. Instants never decrease over the life of a plant."""

    @abstractmethod
    def act(self, setpoint: Setpoint, now: int) -> None:
        """Follow `setpoint` from `now` on."""

    def finish(self, now: int, reason: str) -> Pauses:
        """Come to rest (land, for a drone), because of `reason`.

        Called at the end of every run, however it ends, if `arm` was called before. Safe to call where it has landed.
        """

    def close(self) -> None:
        """Release what `prepare` took. Safe to call twice, and after a failed `prepare`."""

    def emergency_stop(self) -> None:
        """Stop all motion at once. Callable from any thread, never through the agent's loop."""


class NoPlant(Plant):
    """The plant of an agent that only computes: nothing to sense, nothing to act on."""

    def sense(self, now: int) -> State:  # noqa: ARG002
        """An empty state."""
        return State()

    def act(self, setpoint: Setpoint, now: int) -> None:
        """Nothing to do."""
