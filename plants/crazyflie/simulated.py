"""The Crazyflie as a plant, simulated."""

from typing import TYPE_CHECKING, Literal

import numpy as np

from dcf_zenoh.plant import Array, Plant, Setpoint, State, read_only
from plants.crazyflie.model.vehicle import read
from plants.sensing import LIGHTHOUSE
from plants.wind import Wind

if TYPE_CHECKING:
    from plants.crazyflie.model.twin import Twin

TICK = 1_000_000  # ns


class Crazyflie(Plant):
    """A Crazyflie 2.x: nonlinear body, the firmware's cascade as its controller, sensing and wind on demand.

    It is commanded as the real one is: a planar acceleration becomes a horizontal velocity to hover with at constant
    height, one in space becomes a velocity in space (then, as on the vehicle, the height sags when the kind of setpoint
    changes). Model time runs in ms, the state in between is that of the last ms carried on at constant velocity. What
    it senses, and flies by, is its estimate: the truth, unless `sensing` says otherwise.

    Take-off and landing take model time but no time of the fleet. `start` lets it climb from the ground until it hovers
    still, 20 s at most, and leaves it hovering at its start position at `now`. `finish` returns when it stands on the
    ground. Without a setpoint's acceleration it brakes, and keeps to the point where it can stop.

    Args:
        start: Start position, shape (2,) or (3,), in m. A third component replaces `height`.
        sample_time: t_s, in s.
        rng: Draws the errors of sensing, and gusts.
        parameters: Name of the file in `parameters`.
        reference: What velocity it is told to fly under an acceleration a. "velocity": that measured when the setpoint
            acts, + a t_s, as in the paper. "planned": the setpoint's, which problems make from what was measured when
            the step began. "integrated": last reference + a t_s. "position": none; it flies to the setpoint's
            position under the firmware's position controller, and creeps where that is only a step ahead.
        height: At which it flies, in m.
        mass: With all that it carries, in kg; the default is that of the parameters.
        sensing: "perfect", or "lighthouse": noise, bias, latency and drop-outs, an estimator behind them.
        wind: Mean velocity of the air, ``[x, y]`` or ``[x, y, z]``, in m/s.
        gusts: Standard deviation of the wind's horizontal components, in m/s.
        gust_time: How long gusts last, in s.

    Raises:
        ValueError: An option is out of its range; the message says which.

    Source: Memon et al. for the reference "velocity"; for the model see `model.dynamics` and `model.cascade`.
    """

    def __init__(
        self,
        start: Array,
        sample_time: float,
        rng: np.random.Generator,
        *,
        parameters: str = "forster2015",
        reference: Literal["velocity", "planned", "integrated", "position"] = "velocity",
        height: float = 1.0,
        mass: float | None = None,
        sensing: Literal["perfect", "lighthouse"] = "perfect",
        wind: tuple[float, float] | tuple[float, float, float] = (0.0, 0.0),
        gusts: float = 0.0,
        gust_time: float = 1.0,
    ) -> None:
        self._height = float(start[2]) if len(start) == 3 else height
        if not self._height > 0:
            raise ValueError(f"height must be positive, in m, not {self._height}")
        if len(start) not in (2, 3):
            raise ValueError(f"start must be [x, y] or [x, y, z], in m, not {start.tolist()}")
        vehicle = read(parameters)
        self._vehicle = vehicle if mass is None else vehicle.carrying(mass)
        self._on_ground = read_only([*start[:2], 0.0])
        self._sample_time = sample_time
        self._reference = reference
        self._sensor = LIGHTHOUSE if sensing == "lighthouse" else None
        self._rng, gust_rng = rng.spawn(2)
        self._wind = Wind(wind, gusts=gusts, gust_time=gust_time, rng=gust_rng)
        self._twin: Twin | None = None
        self._began = 0  # instant of the twin's tick 0, ns
        self._now = 0
        self._velocity_reference: Array | None = None
        self._stopped = False

    def prepare(self) -> None:
        """Load the machine code, or compile it if this is the first run."""
        from plants.crazyflie.model.twin import Twin  # noqa: PLC0415

        calm = Wind((0.0, 0.0), rng=self._rng)
        Twin(self._vehicle, self._on_ground, None, sensor=None, wind=calm, rng=self._rng).run(1)

    def start(self, now: int) -> None:
        """Take off before `now`: at `now` it hovers at its start position.

        Raises:
            PlantError: The wind carried it away.
        """
        twin = self._twin = self._new_twin(self._on_ground, None)
        twin.take_off(self._height)
        self._began = now - twin.tick * TICK
        self._now = now

    def resume(self, state: State, now: int) -> None:
        """Go on from `state`, level and trimmed, and brake: the vehicle was in the air all the time."""
        position = np.array([*state.position, self._height][:3])
        velocity = np.array([*state.velocity, 0.0][:3])
        self._twin = self._new_twin(position, velocity)
        self._began = self._now = now
        self._twin.hold(self._height)

    def sense(self, now: int) -> State:
        """Estimated position and velocity at `now`, shape (3,) each."""
        twin = self._advance(now)
        since = max(0, self._now - self._began - twin.tick * TICK) * 1e-9
        estimate = twin.estimate
        return State(read_only(estimate[:3] + estimate[3:] * since), read_only(estimate[3:]))

    def act(self, setpoint: Setpoint, now: int) -> None:
        """Follow the setpoint's acceleration by way of `reference`; without one, brake and hover.

        Raises:
            ValueError: The setpoint is neither planar nor in space.
        """
        twin = self._advance(now)
        if setpoint.acceleration is None:
            self._velocity_reference = None
            twin.hold(self._height)
        elif self._reference == "position":
            self._go_to(twin, setpoint.position)
        elif self._reference == "planned":
            self._fly_at(twin, setpoint.velocity)
        else:
            self._fly_at(twin, self._reference_for(twin, setpoint.acceleration))

    def finish(self, now: int, reason: str) -> None:  # noqa: ARG002
        """Land where it is, whatever the reason."""
        twin = self._advance(now)
        if not self._stopped:
            twin.land()
        self._now = max(self._now, self._began + twin.tick * TICK)

    def emergency_stop(self) -> None:
        """Cut the motors: it falls from where it is when its time next goes on."""
        self._stopped = True

    def _reference_for(self, twin: "Twin", acceleration: Array) -> Array:
        """The velocity that `acceleration` leads to within one sample, in as many dimensions."""
        size = len(acceleration)
        _check_size(size)
        before = twin.estimate[3:]
        if self._reference == "integrated" and self._velocity_reference is not None:
            before = self._velocity_reference
        self._velocity_reference = before + np.array([*acceleration, 0.0][:3]) * self._sample_time
        return self._velocity_reference[:size]

    def _fly_at(self, twin: "Twin", velocity: Array) -> None:
        _check_size(len(velocity))
        x, y, z = (float(component) for component in [*velocity, 0.0][:3])
        if len(velocity) == 2:
            twin.hover((x, y), self._height)
        else:
            twin.fly_at((x, y, z))

    def _go_to(self, twin: "Twin", position: Array) -> None:
        _check_size(len(position))
        x, y, z = (float(component) for component in [*position, self._height][:3])
        twin.go_to((x, y, z))

    def _new_twin(self, position: Array, velocity: Array | None) -> "Twin":
        from plants.crazyflie.model.twin import Twin  # noqa: PLC0415 - compiles; whoever flies another plant need not wait

        return Twin(self._vehicle, position, velocity, sensor=self._sensor, wind=self._wind, rng=self._rng)

    def _advance(self, now: int) -> "Twin":
        if self._twin is None:
            self._twin = self._new_twin(self._on_ground, None)
        twin = self._twin
        if self._stopped:
            twin.stop()
        self._now = max(self._now, now)
        twin.run(max(0, (self._now - self._began) // TICK - twin.tick))
        return twin


def _check_size(size: int) -> None:
    if size not in (2, 3):
        raise ValueError(f"a setpoint of {size} components for a Crazyflie, which follows 2 or 3")
