"""cflib connects to the emulator: tables, logs, parameters, memories."""

import socket
import time
from pathlib import Path

import numpy as np
import pytest
from cflib.crazyflie.mem import (
    LighthouseBsCalibration,
    LighthouseBsGeometry,
    LighthouseMemHelper,
    MemoryElement,
    Poly4D,
)
from cflib.crazyflie.param import Param
from cflib.crtp.crtpstack import CRTPPacket
from cflib.localization import LighthouseConfigWriter

from tests.support.cflib_client import Client, client
from tests.support.emulated import Emulated
from tests.support.waiting import until

pytestmark = pytest.mark.real_time

LOGGED = [
    *(f"stateEstimate.{each}" for each in ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw")),
    *(f"stabilizer.{each}" for each in ("roll", "pitch", "yaw")),
    *(f"kalman.{each}" for each in ("varPX", "varPY", "varPZ")),
    *(
        f"lighthouse.{each}"
        for each in ("bsReceive", "bsActive", "bsGeoVal", "bsCalVal", "bsCalUd", "bsCalCon", "status")
    ),
    *("pm.vbat", "pm.state", "pm.batteryLevel", "radio.rssi", "supervisor.info"),
    *("sys.canfly", "sys.isFlying", "sys.isTumbled"),
]
PARAMETERS = [
    *("kalman.resetEstimation", "stabilizer.controller", "stabilizer.estimator", "commander.enHighLevel"),
    *("supervisor.infdmp", "flightmode.stabModeYaw", "deck.bcLighthouse4", "deck.bcFlow2", "lighthouse.method"),
    *("system.forceArm", "system.arm", "pid_rate.roll_kp", "pid_attitude.yaw_kd", "velCtlPid.vxKp", "posCtlPid.zKi"),
]


def test_all_that_clients_ask_for_is_in_the_tables(cf: Client) -> None:
    for name in LOGGED:
        assert cf.cf.log.toc.get_element_by_complete_name(name) is not None, name
    for name in PARAMETERS:
        assert cf.cf.param.get_value(name) is not None, name
    assert cf.cf.param.get_value("deck.bcLighthouse4") == "1"
    assert cf.cf.platform.get_protocol_version() == 12


def test_second_connection_takes_the_tables_from_the_cache(drone: Emulated, tmp_path: Path) -> None:
    drone.renew()
    times = []
    for _ in range(2):
        began = time.monotonic()
        with client(drone.uri, tmp_path):
            times.append(time.monotonic() - began)
    assert len(list(tmp_path.glob("*.json"))) == 2
    assert times[1] < times[0] - 0.3


def test_log_block_comes_at_its_period_in_the_types_that_were_asked_for(cf: Client) -> None:
    config = cf.log("stateEstimate.x", "stateEstimate.z", "pm.batteryLevel", "supervisor.info", period=50)
    began, count = time.monotonic(), cf.received
    until(lambda: cf.received >= count + 20, "20 packets")
    assert time.monotonic() - began == pytest.approx(1.0, abs=0.3)
    assert cf.logged["pm.batteryLevel"] == 90
    assert int(cf.logged["supervisor.info"]) & 1  # can be armed
    config.stop()
    until(lambda: not config.started, "it is stopped")
    count = cf.received
    cf.stream(0.3, lambda: None)
    assert cf.received <= count + 1


def test_persistent_parameter_survives_a_restart_until_it_is_cleared(drone: Emulated, tmp_path: Path) -> None:
    drone.renew()
    name, states, done = "pid_rate.roll_kp", [], []

    def state(parameters: Param) -> None:
        parameters.persistent_get_state(name, lambda _, found: states.append(tuple(found)))
        until(lambda: len(states) > before, "the state")

    with client(drone.uri, tmp_path) as cf:
        before = 0
        parameters = cf.cf.param
        state(parameters)
        parameters.set_value(name, 240.0)
        parameters.persistent_store(name, lambda _, stored: done.append(stored))
        until(lambda: bool(done), "it is stored")
    drone.say("restart")
    with client(drone.uri, tmp_path) as cf:
        before = 1
        assert float(cf.cf.param.get_value(name)) == 240.0
        state(cf.cf.param)
        cf.cf.param.persistent_clear(name, lambda _, cleared: done.append(cleared))
        until(lambda: len(done) == 2, "it is cleared")
    assert states == [(False, 250.0, None), (True, 250.0, 240.0)]
    assert done == [True, True]


def test_written_parameter_is_read_back_and_a_fixed_one_is_not_written(cf: Client) -> None:
    told: list[str] = []
    cf.cf.param.add_update_callback("stabilizer", "controller", lambda _, value: told.append(value))
    cf.cf.param.set_value("stabilizer.controller", 2)
    until(lambda: told == ["2"], "the new value comes back")
    cf.cf.param.request_param_update("stabilizer.controller")
    until(lambda: told == ["2", "2"], "it is read again")
    with pytest.raises(AttributeError, match="read-only"):
        cf.cf.param.set_value("deck.bcFlow2", 1)
    defaults: list[float] = []
    cf.cf.param.get_default_value("stabilizer.controller", lambda _, value: defaults.append(value))
    until(lambda: defaults == [1], "the default comes")


def test_reset_makes_the_variance_large_and_it_settles(cf: Client, drone: Emulated) -> None:
    drone.say("place 1 2")
    cf.log("kalman.varPX", "stateEstimate.x", "stateEstimate.y", period=10)
    until(lambda: cf.logged["kalman.varPX"] < 1e-3 and abs(cf.logged["stateEstimate.x"] - 1.0) < 0.01, "settled")
    cf.cf.param.set_value("kalman.resetEstimation", "1")
    until(lambda: cf.logged["kalman.varPX"] > 10, "it has forgotten")
    assert abs(cf.logged["stateEstimate.x"]) < 0.7
    took = until(lambda: cf.logged["kalman.varPX"] < 1e-3, "it knows again")
    assert 0.5 < took < 3.0
    assert cf.logged["stateEstimate.y"] == pytest.approx(2.0, abs=0.01)


def test_link_is_measured(cf: Client) -> None:
    latency = cf.cf.link_statistics.latency
    latency.start()
    until(lambda: latency.latency > 0, "a ping has come back")
    latency.stop()
    assert 10.0 < latency.latency < 200.0  # ms; two times 5 ms of radio at least


def test_base_stations_are_written_stored_and_read_back(cf: Client, drone: Emulated) -> None:
    cf.log("lighthouse.bsGeoVal", "lighthouse.bsCalVal", "lighthouse.bsActive", "lighthouse.status")
    assert [cf.logged[f"lighthouse.{name}"] for name in ("bsGeoVal", "bsCalVal", "bsActive")] == [0b11, 0b11, 0b11]
    geometry, calibration = LighthouseBsGeometry(), LighthouseBsCalibration()
    geometry.origin, geometry.valid = [1.0, 2.0, 3.0], True
    geometry.rotation_matrix = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    calibration.uid, calibration.valid = 0x1234, True
    done: list[bool] = []
    writer = LighthouseConfigWriter(cf.cf, nr_of_base_stations=16)
    writer.write_and_store_config(done.append, geos={1: geometry}, calibs={1: calibration})
    until(lambda: done, "all is written", 20.0)
    assert done == [True]
    until(lambda: cf.logged["lighthouse.bsGeoVal"] == 0b10, "station 0 is gone")
    until(lambda: cf.logged["lighthouse.bsActive"] == 0b10, "the log shows it, after 0.7 s at most", 2.0)

    read: dict[int, LighthouseBsGeometry] = {}
    LighthouseMemHelper(cf.cf).read_all_geos(read.update)
    until(lambda: len(read) == 16, "all are read", 20.0)
    assert read[1].valid
    assert not read[0].valid
    assert read[1].origin == geometry.origin
    assert read[1].rotation_matrix == geometry.rotation_matrix

    forgotten = LighthouseBsGeometry()
    forgotten.valid = True
    done.clear()
    LighthouseMemHelper(cf.cf).write_geos({5: forgotten}, done.append)
    until(lambda: cf.logged["lighthouse.bsGeoVal"] == 0b100010, "it is written, but not stored")
    drone.say("restart")
    cf.renew()
    cf.log("lighthouse.bsGeoVal", "lighthouse.status")
    assert cf.logged["lighthouse.bsGeoVal"] == 0b10

    drone.say("base-stations 1")
    until(lambda: cf.logged["lighthouse.status"] == 1, "what it sees is of no use without geometry")


def test_question_whether_somebody_is_there_is_answered_and_changes_nothing(cf: Client, drone: Emulated) -> None:
    cf.log("pm.vbat")
    host, port = drone.uri.removeprefix("udp://").split(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.settimeout(2.0)
        asking.sendto(b"\xff", (host, int(port)))
        assert asking.recv(64) == b"\xff"
    count = cf.received
    until(lambda: cf.received > count + 5, "logs still go to the client")


def test_nonsense_is_not_answered_and_does_no_harm(cf: Client, drone: Emulated) -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        packet = CRTPPacket()
        port = int(rng.choice([0, 1, 2, 3, 4, 5, 6, 8, 10, 11, 12, 13, 14]))
        packet.set_header(port, int(rng.integers(0, 4)))
        packet.data = bytes(rng.integers(0, 256, int(rng.integers(0, 31)), dtype=np.uint8))
        cf.cf.link.send_packet(packet)
    until(lambda: drone.state["time"] > 0, "it lives")


def test_trajectory_is_uploaded_and_flown(drone: Emulated, cf: Client) -> None:
    assert sorted(each.type for each in cf.cf.mem.mems) == sorted(
        [MemoryElement.TYPE_LH, MemoryElement.TYPE_MEMORY_TESTER, MemoryElement.TYPE_TRAJ]
    )
    (memory,) = cf.cf.mem.get_mems(MemoryElement.TYPE_TRAJ)
    straight = Poly4D.Poly([0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # 0.5 m/s
    memory.trajectory = [Poly4D(2.0, x=straight), Poly4D(1.0, x=Poly4D.Poly([1.0, *[0.0] * 7]))]
    assert memory.write_data_sync(start_addr=8)
    commander = cf.cf.high_level_commander
    commander.define_trajectory(1, 8, 2)
    cf.take_off()
    begin = drone.state["position"]
    commander.start_trajectory(1, relative_position=True)
    until(lambda: drone.state["position"][0] > begin[0] + 0.9, "the end of the trajectory", 6.0)
    cf.land(1.0)
    until(lambda: drone.state["position"][2] == 0.0, "on the ground", 4.0)
    assert abs(drone.state["position"][1] - begin[1]) < 0.1


def test_console_text_reaches_the_client(drone: Emulated, cache: Path) -> None:
    text: list[str] = []
    drone.renew()
    with client(drone.uri, cache) as connected:
        connected.cf.console.receivedChar.add_callback(text.append)
        drone.say("restart")
        until(lambda: "up and running!" in "".join(text), "text of the console", 3.0)
