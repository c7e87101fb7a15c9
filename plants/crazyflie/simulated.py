"""Simulated Crazyflie as a plant."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from dcf_zenoh.plant import Array, Piece, Plant, Setpoint, State, read_only
from plants.crazyflie.model.vehicle import read
from plants.crazyflie.options import FlightOptions, check_height, lead_of, reference_for
from plants.sensing import LIGHTHOUSE
from plants.wind import Wind, WindOptions

if TYPE_CHECKING:
    from plants.crazyflie.model.twin import Twin

TICK = 1_000_000  # ns
_PIECE = 10  # ticks of a piece of the path: a period of the position loop


class Crazyflie(Plant):
    """Crazyflie 2.x: nonlinear body, the firmware's cascaded controller, optional sensing errors and wind.

    It is commanded like the real one: a planar acceleration becomes a horizontal velocity at constant height, one in
    space becomes a velocity in space (then, as on the vehicle, the height sags when the kind of setpoint changes).
    Model time runs in ms; in between, the state is extrapolated at constant velocity. Agent and controller use the
    estimated state, which is exact unless `sensing` adds errors.

    Take-off and landing take model time but no fleet time. `start` climbs from the ground until the vehicle hovers,
    20 s at most, and leaves it hovering at its start position at `now`. `finish` returns when the vehicle stands on the
    ground. On a setpoint without acceleration it brakes and holds the point where it can stop.

    Args:
        start: Start position, shape (2,) or (3,), in m. A third component replaces `flight.height`.
        sample_time: Sample time t_s, in s.
        rng: Source of sensing errors and gusts.
        parameters: Name of the file in `parameters`.
        mass: Total mass, in kg; the default is that of the parameters.
        flight: Height and reference.
        sensing: "perfect", or "lighthouse": noise, bias, latency and drop-outs, with estimators of position and
            attitude.
        wind: Mean velocity and gusts of the air.

    Raises:
        ValueError: An option is out of its range, or the reference does not follow at this sample time.

    Source: Memon et al. for the reference "velocity"; for the model see `model.dynamics` and `model.cascade`.
    """

    RENAMED: ClassVar[Mapping[str, str]] = {
        "height": "flight.height",
        "reference": "flight.reference",
        "wind": "wind.mean",
        "gusts": "wind.gusts",
        "gust_time": "wind.gust_time",
    }

    def __init__(
        self,
        start: Array,
        sample_time: float,
        rng: np.random.Generator,
        *,
        parameters: str = "forster2015",
        mass: float | None = None,
        flight: FlightOptions = FlightOptions(),  # noqa: B008 - frozen
        sensing: Literal["perfect", "lighthouse"] = "perfect",
        wind: WindOptions = WindOptions(),  # noqa: B008 - frozen
    ) -> None:
        self._height = float(start[2]) if len(start) == 3 else flight.height
        check_height(self._height)
        if len(start) not in (2, 3):
            raise ValueError(f"start must be [x, y] or [x, y, z], in m, not {start.tolist()}")
        vehicle = read(parameters)
        self._vehicle = vehicle if mass is None else vehicle.carrying(mass)
        self._on_ground = read_only([*start[:2], 0.0])
        self._sample_time = sample_time
        self._reference = reference_for(flight.reference, sample_time)
        self._lead = lead_of(self._reference, sample_time)
        self._sensor = LIGHTHOUSE if sensing == "lighthouse" else None
        self._rng, gust_rng = rng.spawn(2)
        self._wind = Wind(wind, rng=gust_rng)
        self._twin: Twin | None = None
        self._began = 0  # instant of tick 0 of the twin, ns
        self._now = 0
        self._velocity_reference: Array | None = None
        self._stopped = False

    def prepare(self) -> None:
        """Load the compiled model, or compile it in the first run."""
        from plants.crazyflie.model.twin import Twin  # noqa: PLC0415

        calm = Wind(WindOptions(), rng=self._rng)
        Twin(self._vehicle, self._on_ground, None, sensor=None, wind=calm, rng=self._rng).run(1)

    def start(self, now: int) -> None:
        """Take off before `now`, so that the vehicle hovers at its start position at `now`.

        Raises:
            PlantError: The vehicle ends elsewhere, as in too strong a wind.
        """
        twin = self._twin = self._new_twin(self._on_ground, None)
        twin.take_off(self._height)
        self._began = now - twin.tick * TICK
        self._now = now

    def resume(self, state: State, now: int) -> None:
        """Continue in flight from `state`, level and trimmed, and brake."""
        position = np.array([*state.position, self._height][:3])
        velocity = np.array([*state.velocity, 0.0][:3])
        self._twin = self._new_twin(position, velocity)
        self._began = self._now = now
        self._twin.hold(self._height)

    def sense(self, now: int) -> State:
        """Return the estimated position and velocity at `now`, shape (3,) each."""
        twin = self._advance(now)
        since = max(0, self._now - self._began - twin.tick * TICK) * 1e-9
        estimate = twin.estimate
        return State(read_only(estimate[:3] + estimate[3:] * since), read_only(estimate[3:]))

    def path(self, until: int) -> Iterator[Piece]:
        """Yield the true path up to `until`: parabolas that meet it every 10 ms. The last ends at a whole tick."""
        twin = self._advance(self._now)
        while (ticks := min(_PIECE, (until - self._began) // TICK - twin.tick)) > 0:
            begin, state = self._began + twin.tick * TICK, _true_state(twin)
            end = begin + ticks * TICK
            self._advance(end)
            yield Piece.between(begin, state, end, twin.state[:3].copy())
        self._advance(until)

    def act(self, setpoint: Setpoint, now: int) -> None:
        """Follow the setpoint's acceleration through the reference; without one, brake and hover.

        Raises:
            ValueError: The setpoint has neither 2 nor 3 components.
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
        """Land at the present position, whatever the reason."""
        twin = self._advance(now)
        if not self._stopped:
            twin.land()
        self._now = max(self._now, self._began + twin.tick * TICK)

    def emergency_stop(self) -> None:
        """Stop the motors; the vehicle falls as its time continues."""
        self._stopped = True

    def _reference_for(self, twin: "Twin", acceleration: Array) -> Array:
        """Return the velocity that `acceleration` leads to within one sample, in as many dimensions."""
        size = len(acceleration)
        _check_size(size)
        before = twin.estimate[3:]
        if self._reference == "integrated" and self._velocity_reference is not None:
            before = self._velocity_reference
        self._velocity_reference = before + np.array([*acceleration, 0.0][:3]) * self._lead
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
        from plants.crazyflie.model.twin import Twin  # noqa: PLC0415 - imports the compiler, which takes long

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


def _true_state(twin: "Twin") -> State:
    return State(read_only(twin.state[:3]), read_only(twin.state[7:10]))


def _check_size(size: int) -> None:
    if size not in (2, 3):
        raise ValueError(f"a setpoint of {size} components for a Crazyflie, which follows 2 or 3")
