"""Point mass under acceleration control."""

from collections.abc import Iterator

import numpy as np

from dcf_zenoh.plant import Array, Piece, Plant, Setpoint, State, read_only


class PointMass(Plant):
    """Point mass whose acceleration is held constant between setpoints, in any number of dimensions.

    The zero-order hold is integrated exactly, so the sample time sets how often the agent decides, never how
    accurately the body moves. There is no drag and no sensor noise: whatever goes wrong on this plant is the
    algorithm's doing.

    Args:
        start: Start position, shape (d,), in m.
        velocity: Start velocity, shape (d,), in m/s; the default is rest.
        accel_max: Bound on each component of the acceleration, in m/s². The input saturates.

    Raises:
        ValueError: `velocity` and `start` differ in length, or `accel_max` is not positive.

    Source: Memon et al., eq. (1) for the model, eq. (4) for the bound.
    """

    def __init__(self, start: Array, *, velocity: tuple[float, ...] | None = None, accel_max: float = 2.0) -> None:
        if not accel_max > 0:
            raise ValueError(f"accel_max must be positive, in m/s², not {accel_max}")
        self._position = read_only(start)
        self._velocity = read_only(np.zeros_like(self._position) if velocity is None else velocity)
        if self._velocity.shape != self._position.shape:
            raise ValueError(f"velocity has {len(self._velocity)} components, start has {len(self._position)}")
        self._accel_max = accel_max
        self._input: Array | None = np.zeros_like(self._position)  # None: brake
        self._now = 0

    def resume(self, state: State, now: int) -> None:
        """Continue from `state` and brake."""
        self._position, self._velocity = read_only(state.position), read_only(state.velocity)
        self._input, self._now = None, now

    def sense(self, now: int) -> State:
        """Return the exact position and velocity at `now`."""
        self._advance(now)
        return State(self._position, self._velocity)

    def path(self, until: int) -> Iterator[Piece]:
        """Yield the exact path up to `until`: one piece, or while it brakes one until each axis rests."""
        stops = [until]
        if self._input is None:
            stops += [self._now + round(rest * 1e9) for rest in (abs(self._velocity) / self._accel_max).tolist()]
        for instant in sorted(set(stops)):
            if self._now < instant <= until:
                braking = -np.sign(self._velocity) * self._accel_max
                acceleration = braking if self._input is None else self._input
                piece = Piece(self._now, self._position, self._velocity, acceleration)
                self._advance(instant)
                if self._input is None:  # an instant in whole ns leaves a rest of velocity
                    self._velocity = read_only(np.where(abs(self._velocity) < 1e-8, 0.0, self._velocity))
                yield piece

    def act(self, setpoint: Setpoint, now: int) -> None:
        """Hold the setpoint's acceleration from `now` on; without one, brake to rest at full deceleration."""
        self._advance(now)
        acceleration = setpoint.acceleration
        if acceleration is not None and acceleration.shape != self._position.shape:
            raise ValueError(f"a setpoint of {len(acceleration)} components for a body of {len(self._position)}")
        self._input = None if acceleration is None else acceleration.clip(-self._accel_max, self._accel_max)

    def _advance(self, now: int) -> None:
        duration = max(0, now - self._now) * 1e-9
        self._now = max(now, self._now)
        if self._input is None:  # each axis decelerates until it rests
            sign = np.sign(self._velocity)
            moving = np.minimum(duration, abs(self._velocity) / self._accel_max)
            change = -sign * self._accel_max * moving
            velocity = np.where(moving < duration, 0.0, self._velocity + change)
            self._position = read_only(self._position + (self._velocity + change / 2) * moving)
            self._velocity = read_only(velocity)
        else:
            self._position = read_only(self._position + self._velocity * duration + self._input * (duration**2 / 2))
            self._velocity = read_only(self._velocity + self._input * duration)
