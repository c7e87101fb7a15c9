"""The pose of a Crazyflie from another system, over Zenoh on the loopback."""

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh

from dcf_zenoh.errors import PlantError
from dcf_zenoh.plant import Setpoint
from plants.crazyflie.flying.pose import PoseFeed, decode
from tests.support.emulated import Emulated, drive
from tests.support.hardware import hardware
from tests.support.waiting import until

pytestmark = pytest.mark.real_time


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulated]:
    with Emulated(tmp_path_factory.mktemp("truth")) as drone:
        yield drone


class MotionCapture:
    """Publishes where the drone really is, 20 times a second, until it is told to stop."""

    def __init__(self, drone: Emulated) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        self._drone = drone
        self.stopped = threading.Event()

    def run(self, session: zenoh.Session) -> None:
        while not self.stopped.wait(0.05):
            session.put("lab/pose/2", json.dumps(self._drone.state["position"]))


@contextmanager
def tracked(drone: Emulated) -> Iterator[MotionCapture]:
    system = MotionCapture(drone)
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([system.endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        thread = threading.Thread(target=system.run, args=(session,))
        thread.start()
        try:
            yield system
        finally:
            system.stopped.set()
            thread.join(5)


@pytest.mark.parametrize("values", [[0.1, -2, 0.3], [0.0, 0.0, 1.0, 0.0, 0.0, 0.6, 0.8]])
def test_positions_and_poses_are_understood(values: list[float]) -> None:
    assert decode(json.dumps(values).encode()) == tuple(values)


@pytest.mark.parametrize(
    "payload",
    [
        *[b"", b"\xff", b"{}", b"[1, 2]", b"[1, 2, NaN]", b'[1, 2, "3"]', b"[0, 0, 0, 1, 1, 1, 1]", b"[true, 0, 0]"],
        *[b"[1e39, 0, 0]", b"[" + b"9" * 400 + b", 0, 0]", b"[" * 20000],  # no packet holds them, no float, no stack
    ],
)
def test_anything_else_is_told(payload: bytes) -> None:
    with pytest.raises(ValueError, match="expected "):
        decode(payload)


def test_a_bad_endpoint_is_an_error() -> None:
    with pytest.raises(PlantError, match=r"^pose 'lab/pose' at nonsense: "):
        PoseFeed("lab/pose", "nonsense").open()


def test_without_a_pose_it_does_not_pass(emulator: Emulated, tmp_path: Path) -> None:
    emulator.renew()
    plant = hardware(uri=emulator.uri, cache=str(tmp_path), pose="lab/pose/{agent}")
    try:
        drive(plant.prepare())
        drive(plant.inspect())
        found = {check.name: check for check in plant.checks()}["localisation"]
    finally:
        plant.close()
    assert found.value == "no pose"
    assert found.problem == "at most 0.5 s is allowed"


def test_it_flies_by_poses_and_lands_when_they_stay_away(emulator: Emulated, tmp_path: Path) -> None:
    emulator.renew(0.2, 0.1)
    emulator.say("base-stations 0")
    with tracked(emulator) as system:
        plant = hardware(
            uri=emulator.uri,
            cache=str(tmp_path),
            height=0.4,
            pose="lab/pose/{agent}",
            pose_endpoint=system.endpoint,
        )
        try:
            drive(plant.prepare())
            drive(plant.inspect())
            checks = {check.name: check for check in plant.checks()}
            assert [check.problem for check in checks.values()] == [""] * 7
            assert checks["localisation"].value.startswith("pose ")
            assert float(checks["start"].value.split()[0]) == pytest.approx(0.22, abs=0.05)
            drive(plant.arm())
            drive(plant.take_off())
            plant.start(0)
            system.stopped.set()

            def noticed() -> bool:
                try:
                    plant.act(Setpoint.hold(plant.sense(0)), 0)
                except PlantError as error:
                    return "the last pose came 0." in str(error)
                return False

            assert until(noticed, "it misses the poses", within=3.0) < 1.5
            drive(plant.finish(0, "failed"))
        finally:
            plant.close()
    assert "touched down" in emulator.events  # it does not know any more where it is, and drifts
    assert emulator.commands("land")
