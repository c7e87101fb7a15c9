"""Lighthouse lost in flight, in model time: what the drone reports, and that the autopilot lands it."""

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from plants.crazyflie.options import WatchdogOptions
from tests.support.model_flight import ModelFlight, model_flight

HEIGHT = 0.5  # m


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[ModelFlight]:
    with model_flight(tmp_path, seed=3) as made:
        made.hover(HEIGHT)
        yield made


def time_until_landing(flight: ModelFlight, within: float) -> float:
    """Time until the autopilot reports a problem, s."""
    began = flight.now
    flight.until(lambda: flight.autopilot.failure, within)
    return flight.now - began


def test_telemetry_shows_it_as_the_firmware_does(tmp_path: Path) -> None:
    with model_flight(tmp_path, watchdog=WatchdogOptions(position_lost="continue")) as flight:
        flight.hover(HEIGHT)
        flight.firmware.lighthouse.received = 0
        began = flight.now
        seen: dict[str, float] = {}
        while flight.now < began + 3.0:
            flight.run(0.01)
            health = flight.telemetry.health
            for name, shown in {
                "no station": health.base_stations == 0,
                "0.001 m2": health.variance.max() > 1e-3,
                "0.01 m2": health.variance.max() > 1e-2,
            }.items():
                if shown:
                    seen.setdefault(name, flight.now - began)
        error = float(np.abs(flight.telemetry.motion.position - flight.position).max())
    assert 0.3 < seen["no station"] < 0.8  # at most 0.1 s of it until the next packet
    assert seen["0.001 m2"] == pytest.approx(1.2, abs=0.15)
    assert seen["0.01 m2"] == pytest.approx(2.7, abs=0.15)
    assert error < 0.2


def test_it_lands_where_it_is(flight: ModelFlight) -> None:
    flight.firmware.lighthouse.received = 0
    before = flight.position
    assert time_until_landing(flight, 3.0) < 1.4
    assert flight.autopilot.failure.startswith("no base station for 0.")
    assert flight.autopilot.failure.endswith(" s, at most 0.5 s is allowed")
    flight.until(lambda: not flight.autopilot.airborne, 10.0)
    (touched,) = flight.events("touched down")
    assert touched["soft"]
    assert np.hypot(*(flight.position - before)[:2]) < 0.5


def test_short_interruption_is_survived(flight: ModelFlight) -> None:
    for _ in range(3):
        flight.firmware.lighthouse.received = 0
        flight.run(0.4)
        flight.firmware.lighthouse.received = 0b11
        flight.run(1.0)
    assert flight.autopilot.failure == ""


def test_one_station_that_is_left_is_enough(flight: ModelFlight) -> None:
    flight.firmware.lighthouse.received = 0b01
    flight.run(3.0)
    assert flight.autopilot.failure == ""


def test_large_variance_makes_it_land_whatever_measures_its_position(flight: ModelFlight) -> None:
    flight.firmware.estimator.fixed_variance = 0.05
    assert time_until_landing(flight, 1.0) < 0.3
    assert flight.autopilot.failure == "variance of its position 5.0e-02 m², at most 0.01 m² is allowed"


def test_drone_without_lighthouse_is_not_asked_for_base_stations(tmp_path: Path) -> None:
    with model_flight(tmp_path) as flight:
        flight.firmware.lighthouse.received = 0
        flight.run(1.0)
        for _ in range(40):  # its position comes from elsewhere
            flight.firmware.estimator.correct(flight.position)
            flight.run(0.05)
        phase = flight.autopilot.take_off(HEIGHT)
        end = flight.now + 4.0
        next(phase)
        while flight.now < end:
            flight.firmware.estimator.correct(flight.position)
            flight.run(0.05)
        assert flight.telemetry.health.base_stations == 0
        assert flight.autopilot.failure == ""


def test_it_flies_on_with_a_warning_if_that_is_chosen(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with (
        caplog.at_level(logging.WARNING),
        model_flight(tmp_path, watchdog=WatchdogOptions(position_lost="continue")) as flight,
    ):
        flight.hover(HEIGHT)
        flight.firmware.lighthouse.received = 0
        flight.run(1.5)
        assert flight.autopilot.failure == ""
    lines = [each.message for each in caplog.records if "position is lost" in each.message]
    assert lines[0].startswith("it flies on, though its position is lost: no base station for 0.")


def test_limits_are_those_of_the_options(tmp_path: Path) -> None:
    with model_flight(tmp_path, watchdog=WatchdogOptions(unmeasured_after=30.0, variance_max=0.001)) as flight:
        flight.hover(HEIGHT)
        flight.firmware.lighthouse.received = 0
        assert time_until_landing(flight, 3.0) == pytest.approx(1.3, abs=0.15)
        assert flight.autopilot.failure.endswith(" m², at most 0.001 m² is allowed")
