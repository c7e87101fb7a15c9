"""Landing of a real Crazyflie: with the radio silent at any of its packets, the emulated drone comes down gently.

In model time. The drone's firmware executes a null setpoint while its planner is idle, as the real one does: with the
notification before the order, the motors are off in the air in 13 of 60 landings, and a silence between the
two ends in a fall at 2.2 m/s.
"""

import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from plants.crazyflie.emulator.crtp import GENERIC, HIGH_LEVEL
from plants.crazyflie.emulator.planner import LAND
from tests.support.model_flight import ModelFlight, model_flight

SILENCE = 0.3  # s
GENTLE = 0.2  # m/s
HEIGHT = 0.5  # m
IN_THE_AIR = 0.02  # m
PACKETS = 11  # of a landing from hover: order, four notifications, three times stop and disarm


class Landed(NamedTuple):
    """What became of a landing: packets sent, speeds of all touchdowns (m/s), heights where the motors stopped (m)."""

    packets: int
    touchdowns: list[float]
    stopped_at: list[float]
    airborne: bool

    @property
    def gentle(self) -> bool:
        """It touched down once, slowly, with its motors running until then."""
        (speed,) = self.touchdowns
        return speed <= GENTLE and not self.airborne and all(height < IN_THE_AIR for height in self.stopped_at)


def hover_at(flight: ModelFlight, speed: float) -> None:
    """Take off, and fly at a speed for a while."""
    flight.hover(HEIGHT)
    for _ in range(8 if speed else 0):
        flight.autopilot.setpoints.follow(np.array([speed, 0.0]), HEIGHT)
        flight.run(0.2)


def landing(folder: Path, *, seed: int, silent_after: int | None = None, speed: float = 0.0, **options: Any) -> Landed:
    """Land, with the radio silent after so many packets of the landing; None: never."""
    with model_flight(folder, seed=seed, phase=0.0037 * seed % 0.01, **options) as flight:
        hover_at(flight, speed)
        flight.clear()
        began = flight.now
        if silent_after == 0:
            flight.silence(SILENCE)

        def silence(number: int) -> None:
            if number + 1 == silent_after:
                flight.silence(SILENCE)

        flight.after_packet = silence
        flight.finish(flight.autopilot.land())
        flight.run(0.5)
        return Landed(
            len(flight.sent),
            [each["speed"] for each in flight.events("touched down", began)],
            [each["height"] for each in flight.events("motors stopped", began)],
            flight.autopilot.airborne,
        )


def test_motors_run_until_it_touches_down(tmp_path: Path) -> None:
    landed = [landing(tmp_path / str(seed), seed=seed) for seed in range(8)]
    assert {each.packets for each in landed} == {PACKETS}
    assert all(each.gentle for each in landed), landed


@pytest.mark.parametrize("silent_after", range(PACKETS + 1))
def test_silence_at_any_packet_does_no_harm(tmp_path: Path, silent_after: int) -> None:
    assert landing(tmp_path, seed=silent_after, silent_after=silent_after).gentle


@pytest.mark.parametrize(
    "silent_after",
    [number if number % 6 == 0 else pytest.param(number, marks=pytest.mark.large) for number in range(54)],
)
def test_silence_at_any_packet_of_a_landing_in_flight_does_no_harm(tmp_path: Path, silent_after: int) -> None:
    landed = landing(tmp_path, seed=silent_after, silent_after=silent_after, speed=0.5)
    assert landed.packets > PACKETS + 30  # it brakes first
    assert landed.gentle


@pytest.mark.large
def test_motors_run_until_it_touches_down_in_many_landings(tmp_path: Path) -> None:
    landed = [landing(tmp_path / str(seed), seed=seed) for seed in range(8, 68)]
    assert all(each.gentle for each in landed), landed


def test_order_comes_before_the_notification_that_is_repeated(tmp_path: Path) -> None:
    with model_flight(tmp_path) as flight:
        hover_at(flight, 0.0)
        flight.clear()
        flight.finish(flight.autopilot.land())
        packets = [(each.packet.port, each.packet.channel, each.packet.data[0]) for each in flight.sent]
        (height,) = struct.unpack_from("<f", flight.sent[0].packet.data, 2)
    assert packets[0] == (HIGH_LEVEL, 0, LAND)
    assert packets[1:5] == [(GENERIC, 1, 0)] * 4
    assert height == pytest.approx(flight.autopilot.ground - 0.01, abs=1e-6)  # else it drops from where the plan ends


def test_notification_that_is_lost_is_made_up_for(tmp_path: Path) -> None:
    with model_flight(tmp_path) as flight:
        hover_at(flight, 0.0)
        flight.clear()
        began = flight.now

        def lose_the_first(number: int) -> None:
            flight.radio.loss = 1.0 if number == 0 else 0.0

        flight.radio.connected = True
        flight.after_packet = lose_the_first
        flight.finish(flight.autopilot.land())
        flight.run(0.5)
        assert "levelling out" not in {each["event"] for each in flight.records if each.kind == "event"}
        assert [each["speed"] <= GENTLE for each in flight.events("touched down", began)] == [True]
