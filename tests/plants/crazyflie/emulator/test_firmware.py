"""The firmware by itself, in its own time: as fast as can be, and the same each time."""

import struct
from pathlib import Path

import numpy as np
import pytest
from cflib.utils.encoding import compress_quaternion

from plants.crazyflie.emulator import crtp
from plants.crazyflie.emulator.battery import Battery
from plants.crazyflie.emulator.crtp import Packet, packet
from plants.crazyflie.emulator.firmware import Firmware
from plants.crazyflie.emulator.ports import Ports
from plants.crazyflie.emulator.setpoints import heading
from plants.crazyflie.emulator.truth import Truth, read_truth
from plants.crazyflie.model.vehicle import read
from plants.sensing import LIGHTHOUSE


class Flown:
    """A drone, flown without a clock.

    Args:
        path: For its truth.
        seed: Of what it senses; None: it senses perfectly.
    """

    def __init__(self, path: Path, seed: int | None = None) -> None:
        self.truth = Truth(path)
        self.path = path
        self.firmware = Firmware(
            read("forster2015"),
            np.array([0.3, -0.2]),
            0.5,
            sensor=None if seed is None else LIGHTHOUSE,
            rng=np.random.default_rng(seed),
            truth=self.truth,
        )
        self.ports = Ports(self.firmware)
        self.run(2.0)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self.firmware.step()

    def tell(self, port: int, channel: int, layout: str, *values: float) -> list[Packet]:
        return self.ports.receive(Packet(port, channel, struct.pack("<" + layout, *values)))

    def arm(self) -> None:
        (answer,) = self.tell(crtp.SUPERVISOR, 1, "BB", 1, 1)
        assert answer.data == bytes((0x81, 1, 1))
        self.run(0.1)

    def take_off(self, height: float, duration: float, *, wait: float) -> None:
        self.tell(crtp.HIGH_LEVEL, 0, "BBff?f", 7, 0, height, 0.0, True, duration)
        self.run(wait)

    def fly_up_and_down(self, down: float) -> None:
        self.arm()
        self.take_off(1.0, 2.0, wait=4.0)
        self.tell(crtp.HIGH_LEVEL, 0, "BBff?f", 8, 0, 0.0, 0.0, True, down)
        self.run(down + 2.5)

    def event(self, name: str) -> list[dict[str, object]]:
        return [dict(r.fields) for r in read_truth(self.path) if r.kind == "event" and r["event"] == name]


@pytest.mark.parametrize("seed", range(10))
def test_planner_lands_softly_on_what_lighthouse_tells(tmp_path: Path, seed: int) -> None:
    flown = Flown(tmp_path / "truth.jsonl", seed)
    with flown.truth:
        flown.fly_up_and_down(3.0)
    (touched,) = flown.event("touched down")
    assert touched["soft"]
    assert len(flown.event("landed")) == 1
    assert flown.event("free fall") == []


def test_fall_from_height_is_told_with_the_speed_of_the_fall(tmp_path: Path) -> None:
    flown = Flown(tmp_path / "truth.jsonl")
    with flown.truth:
        flown.arm()
        flown.take_off(1.5, 2.0, wait=4.0)
        height = float(flown.firmware.body.position[2])
        flown.tell(crtp.COMMANDER, 0, "fffH", 0, 0, 0, 0)
        flown.run(2.0)
    (touched,) = flown.event("touched down")
    free = (2 * 9.81 * height) ** 0.5
    assert not touched["soft"]
    speed = touched["speed"]
    assert isinstance(speed, float)
    assert 0.6 * free < speed < free  # its rotors run down at first


def test_same_seed_gives_the_same_flight(tmp_path: Path) -> None:
    flights = []
    for name in ("one", "two"):
        flown = Flown(tmp_path / name, seed=5)
        with flown.truth:
            flown.fly_up_and_down(2.0)
        flights.append((tmp_path / name).read_text())
    assert flights[0] == flights[1]


def test_packet_of_the_wrong_length_is_not_answered_and_moves_nothing(tmp_path: Path) -> None:
    flown = Flown(tmp_path / "truth.jsonl")
    with flown.truth:
        flown.arm()
        for port, channel in (
            (3, 0),
            (7, 0),
            (8, 0),
            (9, 0),
            (9, 1),
            (2, 1),
            (2, 3),
            (4, 0),
            (4, 1),
            (5, 1),
            (6, 1),
            (13, 1),
        ):
            assert flown.ports.receive(Packet(port, channel, b"")) == []
        assert flown.ports.receive(Packet(7, 0, b"\x0a\x00\x00")) == []
        assert flown.ports.receive(Packet(8, 0, b"\x07\x00\x00")) == []
        assert flown.ports.receive(Packet(14, 3, b"\x00")) == []
        flown.run(1.0)
    assert flown.firmware.body.position[2] == 0.0


def test_setpoint_that_is_no_number_stops_the_motors(tmp_path: Path) -> None:
    flown = Flown(tmp_path / "truth.jsonl")
    with flown.truth:
        flown.arm()
        flown.take_off(1.0, 1.0, wait=2.0)
        flown.tell(crtp.GENERIC, 0, "Bffff", 10, float("nan"), 0.0, 0.0, 1.0)
        flown.run(0.1)
    assert not flown.firmware.body.running
    assert np.isfinite(flown.firmware.body.state).all()


def test_orders_are_recorded_with_their_numbers_and_whether_they_were_accepted(tmp_path: Path) -> None:
    flown = Flown(tmp_path / "truth.jsonl")
    with flown.truth:
        flown.tell(crtp.HIGH_LEVEL, 0, "BBff?f", 7, 0, 0.5, 0.25, True, 2.0)
        flown.arm()
        flown.tell(crtp.HIGH_LEVEL, 0, "BBff?f", 7, 0, 0.5, 0.25, True, 2.0)
        flown.tell(crtp.HIGH_LEVEL, 0, "BB??fffff", 12, 0, True, False, 1.0, 2.0, 3.0, 0.5, 4.0)
    orders = [r.fields for r in read_truth(flown.path) if r.kind == "command" and r["command"] != "arm"]
    assert orders == [
        {"command": "take_off", "values": [0.5, 0.25, 2.0], "accepted": False},
        {"command": "take_off", "values": [0.5, 0.25, 2.0], "accepted": True},
        {"command": "go_to", "values": [1.0, 2.0, 3.0, 0.5, 4.0], "accepted": True},
    ]


def test_bytes_that_are_no_packet_are_told() -> None:
    assert packet(b"") is None
    assert packet(b"\xff") is None
    assert packet(bytes(32)) is None
    assert packet(b"\x5d\x01") == Packet(5, 1, b"\x01")
    assert Packet(5, 1, b"\x01").wire == b"\x5d\x01"


@pytest.mark.parametrize("yaw", np.radians([-170.0, -90.0, -10.0, 0.0, 45.0, 120.0, 180.0]))
def test_heading_is_found_in_a_packed_quaternion(yaw: float) -> None:
    packed = compress_quaternion([0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))])
    assert abs(np.angle(np.exp(1j * (heading(packed) - yaw)))) < 0.005


def test_estimator_without_base_stations_gets_unsure_and_recovers_by_a_position_from_outside(tmp_path: Path) -> None:
    flown = Flown(tmp_path / "truth.jsonl", seed=1)
    estimator = flown.firmware.estimator
    with flown.truth:
        assert estimator.variance < 1e-3
        flown.firmware.lighthouse.received = 0
        flown.run(1.1)
        assert estimator.variance < 1e-3
        flown.run(0.2)
        assert estimator.variance > 1e-3
        flown.run(1.2)
        assert estimator.variance < 1e-2
        flown.run(0.3)
        assert estimator.variance > 1e-2
        flown.run(4.0)
        assert estimator.variance > 0.1
        for _ in range(200):
            flown.tell(crtp.LOCALISATION, 0, "fff", *flown.firmware.body.position)
            flown.run(0.02)
    assert estimator.variance < 1e-3
    np.testing.assert_allclose(estimator.estimate[:3], flown.firmware.body.position, atol=0.02)


def test_battery_is_empty_after_about_seven_minutes_of_hovering() -> None:
    battery = Battery()
    assert battery.level == 90
    minutes = 0.0
    while battery.voltage > 3.0:
        battery.step(0.6, 1.0)
        minutes += 1 / 60
    assert minutes == pytest.approx(7.0, abs=0.1)
    assert battery.level == 0
    assert battery.state == 3


def test_console_text_waits_for_a_client_and_tells_of_a_lock(tmp_path: Path) -> None:
    flown = Flown(tmp_path / "truth.jsonl")

    def console(seconds: float) -> str:
        packets = [each for _ in range(round(seconds * 100)) for each in flown.firmware.step()]
        return b"".join(each.data for each in packets if each.port == crtp.CONSOLE).decode()

    with flown.truth:
        assert console(1.0) == ""
        flown.tell(crtp.LINK, 1, "B", 0)
        assert console(1.0).splitlines() == [
            "SYS: emulated Crazyflie 2.1 is up and running!",
            "ESTIMATOR: Using Kalman (2) estimator",
            "CONTROLLER: Using PID (1) controller",
        ]
        flown.arm()
        flown.firmware.stop()
        assert console(0.5) == "SUP: free fall\nSUP: locked\n"


def test_firmware_of_brushed_crazyflies_arms_itself_again(tmp_path: Path) -> None:
    flown = Flown(tmp_path / "truth.jsonl")
    with flown.truth:
        assert flown.firmware.bits & 0b111 == 0b001  # can be armed
        flown.firmware.automatic = True
        flown.run(0.1)
        assert flown.firmware.bits & 0b111 == 0b110  # armed, arms itself
        flown.tell(crtp.SUPERVISOR, 1, "BB", 1, 0)
        assert not flown.firmware.supervisor.armed
        flown.run(0.2)
        assert flown.firmware.supervisor.armed
        flown.take_off(0.5, 1.0, wait=2.0)
        flown.tell(crtp.HIGH_LEVEL, 0, "BBff?f", 8, 0, 0.0, 0.0, True, 1.0)
        flown.run(8.0)  # disarmed 3 s after the landing
        assert flown.firmware.supervisor.armed
        flown.run(29.0)  # disarmed after 30 s without a take-off
    assert len(flown.event("landed")) == 1
    assert len(flown.event("armed")) == 4


def test_lighthouse_deck_that_falls_silent_stops_the_motors_after_a_while(tmp_path: Path) -> None:
    flown = Flown(tmp_path / "truth.jsonl", seed=1)
    with flown.truth:
        flown.arm()
        flown.take_off(0.5, 1.0, wait=2.0)
        flown.firmware.lighthouse.silent = True
        flown.run(1.4)
        assert flown.firmware.body.running
        assert flown.firmware.bits >> 11 == 0
        flown.run(0.2)
        assert not flown.firmware.body.running
        assert flown.firmware.bits >> 11 == 1
        assert not flown.firmware.bits & 0b1000  # cannot fly


def test_parameters_tell_their_types_and_refuse_as_the_firmware_does(tmp_path: Path) -> None:
    flown = Flown(tmp_path / "truth.jsonl")
    table = flown.firmware.parameters._table

    def number(name: str) -> int:
        found = table.number(name)
        assert found is not None
        return found

    def kind(name: str) -> int:
        (answer,) = flown.tell(crtp.PARAM, 0, "BH", 2, number(name))
        return answer.data[3]

    with flown.truth:
        assert kind("pid_rate.roll_kp") == 0x06 | 0x10 | 0x20  # float, persistent, core
        assert kind("deck.bcLighthouse4") == 0x08 | 0x20 | 0x40  # read-only
        assert kind("supervisor.tmblChckEn") == 0x08
        assert flown.tell(crtp.PARAM, 2, "HB", number("deck.bcFlow2"), 1) == []
        effect = number("ring.effect")
        (answer,) = flown.tell(crtp.PARAM, 2, "HH", effect, 7)  # too long: not set
        assert answer.data == struct.pack("<HB", effect, 0)
        (answer,) = flown.tell(crtp.PARAM, 2, "HB", effect, 7)
        assert answer.data == struct.pack("<HB", effect, 7)


def test_world_velocities_lose_height(tmp_path: Path) -> None:
    flown = Flown(tmp_path / "truth.jsonl")
    with flown.truth:
        flown.arm()
        flown.take_off(1.0, 2.0, wait=12.0)
        before = float(flown.firmware.body.position[2])
        for _ in range(60):
            flown.tell(crtp.GENERIC, 0, "Bffff", 8, 0.0, 0.0, 0.0, 0.0)
            flown.run(0.05)
    assert 0.05 < before - flown.firmware.body.position[2] < 0.4  # the change of mode resets the vertical integral
