"""The Crazyflie as a plant."""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.config import Overrides, load
from dcf_zenoh.errors import ConfigurationError, PlantError
from dcf_zenoh.plant import Array, Setpoint, State
from dcf_zenoh.testing import check_plant
from plants.crazyflie.options import FlightOptions, Reference
from plants.crazyflie.simulated import Crazyflie
from plants.wind import WindOptions

S = 1_000_000_000  # ns
SAMPLE = S // 5
START = np.array([0.3, -0.2])
REFERENCES: tuple[Reference, ...] = ("velocity", "integrated")


def crazyflie(start: Array = START, seed: int = 1, **options: Any) -> Crazyflie:
    return Crazyflie(start, 0.2, np.random.Generator(np.random.Philox(seed)), **options)


def flying(**options: Any) -> Crazyflie:
    body = crazyflie(**options)
    body.prepare()
    body.start(0)
    return body


def accelerate(*a: float) -> Setpoint:
    return Setpoint(acceleration=np.array(a))


def path(body: Crazyflie, *, steps: int = 10, policy: Callable[[int], Setpoint] | None = None) -> Array:
    """States at the samples, an acceleration of 0.5 m/s² along x in each."""
    states = []
    for step in range(steps):
        states.append(body.sense(step * SAMPLE).vector)
        body.act(policy(step) if policy else accelerate(0.5, 0.0), step * SAMPLE)
    return np.array(states)


def test_it_keeps_the_contract_of_a_plant() -> None:
    check_plant(crazyflie)


def test_it_keeps_the_contract_in_wind() -> None:
    check_plant(lambda: crazyflie(wind=WindOptions((0.5, 0.2)), parameters="cf2x_p250"))


def test_it_starts_hovering_at_its_start() -> None:
    state = flying(flight=FlightOptions(height=0.7)).sense(0)
    np.testing.assert_allclose(state.position, [0.3, -0.2, 0.7], atol=0.011)
    np.testing.assert_allclose(state.velocity, 0, atol=0.011)


def test_a_start_in_space_has_its_own_height() -> None:
    assert flying(start=np.array([0.0, 0.0, 1.4])).sense(0).position[2] == pytest.approx(1.4, abs=0.011)


def test_planar_setpoints_keep_the_height() -> None:
    states = path(flying(), steps=15)
    np.testing.assert_allclose(states[:, 2], 1.0, atol=0.05)
    assert states[-1, 0] > 0.5


def test_a_setpoint_in_space_climbs() -> None:
    states = path(flying(), steps=15, policy=lambda _: accelerate(0.0, 0.0, 2.0))
    assert states[-1, 2] > 1.2


def test_within_a_sample_a_velocity_is_met_to_about_a_third() -> None:
    body = flying(parameters="cf2x_p250")
    body.act(accelerate(2.5, 0.0), 0)  # to 0.5 m/s
    assert 0.1 < body.sense(SAMPLE).velocity[0] / 0.5 < 0.4


def test_references_differ_as_they_say() -> None:
    measured, integrated = (path(flying(flight=FlightOptions(reference=each))) for each in REFERENCES)
    assert integrated[-1, 3] > 1.5 * measured[-1, 3]  # measured velocity lags, so its reference asks for less
    plan = Setpoint(velocity=np.array([0.5, 0.0]), acceleration=np.zeros(2))
    planned = path(flying(flight=FlightOptions(reference="planned")), steps=15, policy=lambda _: plan)
    assert planned[-1, 3] == pytest.approx(0.5, abs=0.06)
    goal = Setpoint(position=np.array([1.0, 0.5]), acceleration=np.zeros(2))
    there = path(flying(flight=FlightOptions(reference="position")), steps=50, policy=lambda _: goal)
    np.testing.assert_allclose(there[-1, :2], [1.0, 0.5], atol=0.02)


def test_holding_brakes_and_hovers() -> None:
    body = flying()
    path(body, steps=12)
    moving = body.sense(12 * SAMPLE)
    body.act(Setpoint.hold(moving), 12 * SAMPLE)
    rest = body.sense(20 * S)
    assert moving.velocity[0] > 0.3
    np.testing.assert_allclose(rest.velocity, 0, atol=5e-3)
    assert 0.05 < rest.position[0] - moving.position[0] < 0.6
    assert rest.position[2] == pytest.approx(1.0, abs=0.03)


def test_a_late_setpoint_acts_late() -> None:
    prompt, late = flying(), flying()
    prompt.act(accelerate(1.0, 0.0), 0)
    late.act(accelerate(1.0, 0.0), SAMPLE // 2)
    assert late.sense(SAMPLE).velocity[0] < 0.5 * prompt.sense(SAMPLE).velocity[0]


@pytest.mark.parametrize("sample_time", [0.02, 0.05, 0.1, 0.5])
def test_acceleration_is_followed_at_any_sample_time(sample_time: float) -> None:
    """Under the reference "velocity" it flies at 0.07 m/s at 0.02 s, at 0.16 m/s at 0.05 s."""
    body = Crazyflie(np.zeros(2), sample_time, np.random.Generator(np.random.Philox(1)))
    body.prepare()
    body.start(0)
    for step in range(round(1.0 / sample_time)):
        body.act(accelerate(1.0, 0.0), round(step * sample_time * S))
    assert 0.8 < body.sense(S).velocity[0] < 1.15  # m/s after 1 s at 1 m/s²


def test_it_lands() -> None:
    body = flying()
    path(body)
    before = body.sense(2 * S)
    body.finish(2 * S, "arrived")
    state = body.sense(2 * S)
    assert state.position[2] == 0
    np.testing.assert_array_equal(state.velocity, 0)
    assert np.linalg.norm(state.position[:2] - before.position[:2]) < 0.3


def test_emergency_stop_lets_it_fall_and_stay_down() -> None:
    body = flying()
    body.emergency_stop()
    body.act(accelerate(1.0, 0.0), S // 10)
    assert body.sense(S).position[2] == 0
    body.finish(S, "stopped")
    np.testing.assert_array_equal(body.sense(3 * S).velocity, 0)


def test_it_resumes_where_it_was_and_comes_to_rest() -> None:
    body = crazyflie()
    body.prepare()
    body.resume(State(np.array([1.0, 2.0, 0.9]), np.array([0.6, 0.0, 0.0])), 7 * S)
    first, last = body.sense(7 * S), body.sense(20 * S)
    np.testing.assert_allclose(first.vector, [1.0, 2.0, 0.9, 0.6, 0.0, 0.0])
    assert 1.05 < last.position[0] < 1.5
    np.testing.assert_allclose(last.velocity, 0, atol=5e-3)


def test_lighthouse_and_gusts_repeat_with_the_seed() -> None:
    options = {"sensing": "lighthouse", "wind": WindOptions((0.5, 0.0), gusts=0.3)}
    first, again, other = (path(flying(seed=seed, **options)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_lighthouse_knows_the_position_to_centimetres() -> None:
    body = flying(sensing="lighthouse")
    errors = []
    for step in range(1, 20):
        body.act(accelerate(0.5, 0.0), (step - 1) * SAMPLE)
        *_, last = body.path(step * SAMPLE)
        rest = (step * SAMPLE - last.begin) * 1e-9
        true = last.position + (last.velocity + last.acceleration * rest / 2) * rest
        errors.append(body.sense(step * SAMPLE).position - true)
    assert 0.001 < abs(np.array(errors)).max() < 0.06


def test_too_strong_a_wind_ends_the_take_off() -> None:
    with pytest.raises(PlantError, match=r"take-off: expected to hover at \[0.3, -0.2, 1.0\] m, came to"):
        flying(wind=WindOptions((40.0, 0.0)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"parameters": "cf3"}, "unknown parameters 'cf3'; known: cf2x_p250, forster2015"),
        ({"mass": -0.03}, "mass must be positive .* not -0.03"),
        ({"start": np.zeros(3)}, "height must be positive, in m, not 0.0"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        crazyflie(**options)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("flight.height=0.0", "flight: height must be positive, in m, not 0.0"),
        ("wind.gusts=-1.0", "wind: gusts must be a standard deviation >= 0, in m/s, not -1.0"),
        ("wind.gust_time=0.0", "wind: gust_time must be positive, in s, not 0.0"),
    ],
)
def test_values_of_sub_tables_out_of_range_are_refused_in_the_fleet_file(change: str, message: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        load("position_swap", Overrides(plant="twin"), changes=[f"plants.twin.{change}"])
    assert refused.value.problems == (f"plants.twin.{message}",)


@pytest.mark.parametrize(
    ("key", "path"),
    [("height", "flight.height"), ("reference", "flight.reference"), ("gusts", "wind.gusts")],
)
def test_earlier_keys_are_refused_with_their_present_names(key: str, path: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        load("position_swap", Overrides(plant="twin"), changes=[f"plants.twin.{key}=1.0"])
    text = f"plants.twin.{key}: Crazyflie has no key {key!r} any more: it is called {path!r}"
    assert refused.value.problems == (text,)


def test_wind_that_is_not_a_table_is_refused_with_its_present_name() -> None:
    with pytest.raises(ConfigurationError) as refused:
        load("position_swap", Overrides(plant="twin"), changes=["plants.twin.wind=[0.5, 0.2]"])
    text = "plants.twin.wind: expected a table, not [0.5, 0.2]; that value is called 'wind.mean' now"
    assert refused.value.problems == (text,)


def test_a_setpoint_of_another_dimension_is_refused() -> None:
    with pytest.raises(ValueError, match="a setpoint of 4 components for a Crazyflie, which follows 2 or 3"):
        flying().act(accelerate(1.0, 0.0, 0.0, 0.0), 0)


def test_reading_a_fleet_file_does_not_wait_for_the_compiler() -> None:
    text = "import sys, plants.crazyflie.simulated; assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", text], check=True, timeout=60)
