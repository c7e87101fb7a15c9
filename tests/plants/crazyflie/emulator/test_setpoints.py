"""Packets as cflib makes them, and what is understood of them."""

import math
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from cflib.crazyflie.commander import Commander
from cflib.crazyflie.high_level_commander import HighLevelCommander
from cflib.crtp.crtpstack import CRTPPacket

from plants.crazyflie.emulator.planner import Planner
from plants.crazyflie.emulator.setpoints import STOP, FirmwareSetpoint, RpytDecoder, generic
from plants.crazyflie.model.cascade import (
    HOVER,
    POSITION,
    STOPPED,
    TILT_CLIMB,
    TILT_HEIGHT,
    TILT_THRUST,
    VELOCITY,
)

PI = math.pi
LEGACY, PRESENT = 8, 12


class Sent:
    """Stands for a `Crazyflie` where cflib makes its packets."""

    def __init__(self, protocol: int = PRESENT) -> None:
        self.platform = SimpleNamespace(get_protocol_version=lambda: protocol)
        self.data = b""

    def send_packet(self, packet: CRTPPacket) -> None:
        self.data = bytes(packet.data)


def understood(method: str, *values: float, protocol: int = PRESENT) -> FirmwareSetpoint | None:
    sent = Sent(protocol)
    getattr(Commander(sent), method)(*values)
    return generic(sent.data)


@pytest.mark.parametrize(
    ("method", "values", "mode", "expected"),
    [
        ("send_stop_setpoint", (), STOPPED, (0, 0, 0, 0)),
        ("send_velocity_world_setpoint", (0.1, -0.2, 0.3, 90.0), VELOCITY, (0.1, -0.2, 0.3, PI / 2)),
        ("send_hover_setpoint", (0.1, -0.2, 45.0, 0.7), HOVER, (0.1, -0.2, 0.7, PI / 4)),
        ("send_position_setpoint", (1.0, -2.0, 0.5, -90.0), POSITION, (1.0, -2.0, 0.5, -PI / 2)),
        ("send_zdistance_setpoint", (9.0, -18.0, 90.0, 0.4), TILT_HEIGHT, (PI / 20, PI / 10, 0.4, PI / 2)),
        ("send_setpoint_manual", (9.0, 18.0, 90.0, 50.0, False), TILT_THRUST, (PI / 20, PI / 10, 35000, PI / 2)),
    ],
)  # fmt: skip
def test_setpoint_is_understood_as_it_was_meant(
    method: str, values: tuple[float, ...], mode: int, expected: tuple[float, ...]
) -> None:
    found = understood(method, *values)
    assert found is not None
    assert found.mode == mode
    assert found.values == pytest.approx(expected, abs=1e-6, rel=1e-4)


@pytest.mark.filterwarnings("ignore:Using legacy:DeprecationWarning")  # it is what is tested
@pytest.mark.parametrize("method", ["send_velocity_world_setpoint", "send_hover_setpoint", "send_zdistance_setpoint"])
def test_older_clients_mean_the_same(method: str) -> None:
    values = (0.1, 0.2, 30.0, 0.4) if method != "send_velocity_world_setpoint" else (0.1, 0.2, 0.4, 30.0)
    old, new = understood(method, *values, protocol=LEGACY), understood(method, *values)
    assert old is not None
    assert new is not None
    assert old.mode == new.mode
    assert old.values == pytest.approx(new.values)


def test_full_state_gives_its_place_and_heading() -> None:
    sent, turned = Sent(), [0.0, 0.0, math.sin(0.4), math.cos(0.4)]
    Commander(sent).send_full_state_setpoint([1.0, -2.0, 0.5], [0.1] * 3, [0.2] * 3, turned, 0.0, 0.0, 0.0)
    found = generic(sent.data)
    assert found is not None
    assert found.mode == POSITION
    assert found.values == pytest.approx((1.0, -2.0, 0.5, 0.8), abs=0.005)


def test_thrust_counts_only_after_it_was_zero_and_pitch_forward_is_nose_down() -> None:
    sent, by_thrust = Sent(), RpytDecoder()
    for thrust, mode in ((40000, STOPPED), (0, STOPPED), (500, STOPPED), (40000, TILT_THRUST), (65535, TILT_THRUST)):
        Commander(sent).send_setpoint(9.0, 18.0, 0.0, thrust)
        found = by_thrust.setpoint(sent.data)
        assert found.mode == mode
    assert found.values == pytest.approx((PI / 20, PI / 10, 60000, 0.0))


def test_what_is_not_known_is_no_setpoint() -> None:
    assert generic(b"\x63") is None
    assert understood("send_setpoint_manual", 1.0, 1.0, 0.0, 50.0, True) is None  # by turn rates
    with pytest.raises(struct.error):
        generic(b"\x0a\x00")


@pytest.mark.parametrize(
    ("mode", "level"),
    [
        (HOVER, TILT_HEIGHT),
        (POSITION, TILT_HEIGHT),
        (TILT_HEIGHT, TILT_HEIGHT),
        (VELOCITY, TILT_CLIMB),
        (TILT_CLIMB, TILT_CLIMB),
        (TILT_THRUST, TILT_THRUST),
    ],
)
def test_levelled_setpoint_keeps_what_was_asked_for_the_vertical(mode: int, level: int) -> None:
    assert FirmwareSetpoint(mode, (0.3, -0.2, 0.7, 0.4)).level == FirmwareSetpoint(level, (0.0, 0.0, 0.7, 0.0))
    assert STOP.level == STOP


def test_planner_understands_cflib() -> None:
    sent, planner = Sent(), Planner()
    commander = HighLevelCommander(sent)
    planner.block(False)
    planner.set_state(np.array([1.0, 2.0, 0.0]), np.zeros(3), 0.3)
    commander.takeoff(0.5, 2.0, yaw=None)
    assert planner.command(sent.data, 0) == 0
    assert planner.setpoint(2000).values == pytest.approx((1.0, 2.0, 0.5, 0.3))
    commander.go_to(0.5, 0.0, 0.0, 0.0, 1.0, relative=True, linear=True)
    assert planner.command(sent.data, 2000) == 0
    assert planner.setpoint(2250).values == pytest.approx((1.125, 2.0, 0.5, 0.3))
    commander.go_to(0.0, 0.0, 1.0, 0.0, 1.0)
    assert planner.command(sent.data, 3000) == 0
    assert planner.setpoint(4000).values == pytest.approx((0.0, 0.0, 1.0, 0.0))
    commander.land(0.1, 1.0, yaw=1.0)
    assert planner.command(sent.data, 4000) == 0
    assert planner.setpoint(4999).values == pytest.approx((0.0, 0.0, 0.1, 1.0), abs=1e-6)
    assert planner.setpoint(5000) == STOP
    commander.takeoff(0.5, 2.0)
    assert planner.command(sent.data, 5000) == 0
    commander.stop()
    assert planner.command(sent.data, 5100) == 0
    assert planner.setpoint(5100) == STOP
