"""Single integrator: a body under velocity control."""

from collections.abc import Iterator

import numpy as np

from dcf_zenoh.plant import Array, Piece, Plant, Setpoint, State, read_only


class SingleIntegrator(Plant):
    """Point that takes the setpoint's velocity at once and keeps it until the next one, in any number of dimensions.

    Only the planned velocity of a setpoint is used. In a receding horizon it is v_measured + a t_s, the paper's
    reference for bodies that track velocity, with the velocity measured when the step began: a setpoint that acts late,
    or twice, has the same effect. A velocity above the limit keeps its direction. The motion is integrated exactly.

    Args:
        start: Start position, shape (d,), in m. The body starts at rest.
        speed_max: Bound on the length of the velocity, in m/s.

    Raises:
        ValueError: `speed_max` is not positive.
    """

    def __init__(self, start: Array, *, speed_max: float = 1.0) -> None:
        if not speed_max > 0:
            raise ValueError(f"speed_max must be positive, in m/s, not {speed_max}")
        self._position = read_only(start)
        self._velocity = read_only(np.zeros_like(self._position))
        self._speed_max = speed_max
        self._now = 0

    def resume(self, state: State, now: int) -> None:
        """Rest at the position of `state`."""
        self._position, self._now = read_only(state.position), now
        self._velocity = read_only(np.zeros_like(self._position))

    def sense(self, now: int) -> State:
        """Return the exact position and velocity at `now`."""
        self._position = read_only(self._position + self._velocity * (max(0, now - self._now) * 1e-9))
        self._now = max(now, self._now)
        return State(self._position, self._velocity)

    def path(self, until: int) -> Iterator[Piece]:
        """Yield the exact path up to `until`: one straight piece."""
        if until > self._now:
            yield Piece(self._now, self._position, self._velocity, np.zeros_like(self._position))
            self.sense(until)

    def act(self, setpoint: Setpoint, now: int) -> None:
        """Move at the setpoint's velocity from `now` on; rest on a setpoint without acceleration, which means hold."""
        self.sense(now)
        if setpoint.acceleration is None:
            self._velocity = read_only(np.zeros_like(self._position))
            return
        velocity = setpoint.velocity
        if velocity.shape != self._position.shape:
            raise ValueError(f"a setpoint with {len(velocity)} velocities for a body of {len(self._position)}")
        speed = float(np.linalg.norm(velocity))
        self._velocity = read_only(velocity * min(1.0, self._speed_max / speed) if speed else velocity)
