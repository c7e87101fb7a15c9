"""The real Crazyflie as a plant, on the ground: options, connecting, what is looked at before the take-off."""

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agentd.launcher.launch import launch
from dcf_zenoh.config import Overrides, load
from dcf_zenoh.errors import ConfigurationError, PlantError
from dcf_zenoh.plant import Check, State
from plants.crazyflie.hardware import CrazyflieHardware
from tests.support.emulated import Emulated, Relay, drive
from tests.support.hardware import hardware
from tests.support.waiting import until

pytestmark = pytest.mark.real_time

URI = "radio://0/80/2M/E7E7E7E701"


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Emulated]:
    with Emulated(tmp_path_factory.mktemp("truth")) as drone:
        yield drone


@pytest.fixture
def drone(emulator: Emulated) -> Emulated:
    emulator.renew(0.1, 0.0)
    return emulator


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def crazyflie(start: tuple[float, ...] = (0.0, 0.0), agent: int = 2, **options: Any) -> CrazyflieHardware:
    return hardware(start, agent=agent, **{"uri": URI, **options})


def refusal(plant: CrazyflieHardware) -> str:
    """Why it does not connect."""
    with pytest.raises(PlantError) as caught:
        drive(plant.prepare())
    plant.close()
    return str(caught.value)


def checks(drone: Emulated, cache: Path, **options: Any) -> dict[str, Check]:
    """What is found before the take-off, by name."""
    plant = crazyflie(uri=drone.uri, cache=str(cache), **options)
    try:
        drive(plant.prepare())
        drive(plant.inspect())
        return {check.name: check for check in plant.checks()}
    finally:
        plant.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"uri": "radio://0/200/2M/E7E7E7E701"},
            "uri 'radio://0/200/2M/E7E7E7E701': channel must be 0 to 125, not '200'",
        ),
        ({"height": 4.0}, "height must be 0.1 to 2.5 m, not 4"),
        ({"height": float("nan")}, "height must be 0.1 to 2.5 m, not nan"),
        ({"start": (0.0, 0.0, 0.0)}, "height must be 0.1 to 2.5 m, not 0"),
        ({"start": (0.0,)}, "start must be [x, y] or [x, y, z], in m, not [0.0]"),
        ({"rate": 5.0}, "rate must be 10 to 100 Hz, not 5"),
        ({"speed_max": 0.0}, "speed_max must be 0.05 to 3 m/s, not 0"),
        ({"battery_min": 12.0}, "battery_min must be 3 to 4.3 V, not 12"),
        ({"battery_low": 3.8}, "battery_low must be below battery_min, 3.7 V, not 3.8"),
        ({"state_age_max": 9.0}, "state_age_max must be 0.1 to 1.5 s, not 9"),
        ({"hold_after": 1.0, "land_after": 0.5}, "land_after must be above hold_after, 1 s, not 0.5"),
        ({"timeout": 0.0}, "timeout must be 1 to 300 s, not 0"),
        ({"retries": -1}, "retries must be 0 to 100, not -1"),
    ],
)
def test_options_out_of_range_are_refused_in_one_line(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=r"^\S") as caught:
        crazyflie(**options)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_it_is_real_and_has_its_drone_for_itself() -> None:
    assert CrazyflieHardware.real
    assert CrazyflieHardware.own_keys == ("uri",)
    uris = ("radio://0/80/2M/E7E7E7E701", "radio://1/80/2M/E7E7E7E701")
    changes = [f"agents.{agent}.plants.hardware.uri={uri!r}" for agent, uri in enumerate(uris, 1)]
    with pytest.raises(
        ConfigurationError, match=rf"agents\.2\.plants\.hardware\.uri: '{uris[1]}' is taken by agent 1;"
    ):
        load("position_swap", Overrides(plant="hardware", clock="wall"), changes=changes)
    assert 10 < CrazyflieHardware.landing_time < 60


def test_two_drones_on_one_radio_are_noted_and_not_launched(tmp_path: Path) -> None:
    uri = "agents.2.plants.hardware.uri=radio://0/94/2M/E7E7E7E702"
    fleet = load("position_swap", Overrides(plant="hardware", clock="wall"), changes=[uri])
    text = "agents.2.plants.hardware.uri: radio 0 is used by agent 1, too: on one computer each agent needs its own"
    assert text in fleet.notes
    with pytest.raises(ConfigurationError, match=text):
        launch(fleet, tmp_path, print, print, yes=True)
    assert list(tmp_path.iterdir()) == []


def test_a_cache_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    text = refusal(crazyflie(cache=str(tmp_path / "file" / "cache")))
    assert text == f"agent 2: cache {tmp_path}/file/cache: Not a directory"


def test_without_cflib_the_error_says_what_to_install() -> None:
    program = """
import sys, time
import numpy as np
sys.modules["cflib"] = None  # importing it fails
from plants.crazyflie.hardware import CrazyflieHardware
plant = CrazyflieHardware(2, np.zeros(2), 0.2, uri="radio://0/80/2M/E7E7E7E701")
for pause in plant.prepare():
    time.sleep(pause)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    last = done.stderr.strip().splitlines()[-1]
    assert "PlantError: agent 2: " in last
    assert "pip install 'dcf-zenoh[crazyflie]'" in last


def test_a_silent_peer_is_given_up_in_time_and_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        uri = f"udp://127.0.0.1:{silent.getsockname()[1]}"
        began = time.monotonic()
        text = refusal(crazyflie(uri=uri, timeout=3.0))
        took = time.monotonic() - began
    assert text.startswith(f"agent 2: no connection to {uri}, tried ")
    assert "no answer for 1 s" in text
    assert took < 7.0


def test_a_silent_peer_over_tcp_is_given_up_in_time() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        uri = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        began = time.monotonic()
        text = refusal(crazyflie(uri=uri, timeout=2.0, retries=0))
        took = time.monotonic() - began
    assert text == f"agent 2: no connection to {uri}, tried once within 2 s: no answer for 1 s"
    assert took < 7.0


def test_where_nobody_listens_the_reason_is_told_once() -> None:
    text = refusal(crazyflie(uri="udp://127.0.0.1:9", timeout=20.0, retries=1))
    assert text.startswith("agent 2: no connection to udp://127.0.0.1:9, tried 2 times within 20 s: ")
    assert text.count("refused") == 1


def test_without_a_radio_the_uri_and_the_reason_are_told() -> None:
    crazyradio = pytest.importorskip("cflib.drivers.crazyradio")
    if crazyradio._find_devices():
        pytest.skip("there is a radio")
    text = refusal(crazyflie(retries=0))
    assert text == f"agent 2: no connection to {URI}, tried once within 30 s: Cannot find a Crazyradio Dongle"


def test_a_lost_attempt_is_followed_by_another(drone: Emulated, cache: Path) -> None:
    plant = crazyflie(uri=drone.uri, cache=str(cache))
    drone.say("silence 1.3")
    took = drive(plant.prepare())
    plant.close()
    assert 1.0 < took < 10.0


def test_a_link_that_loses_packets_connects_all_the_same(drone: Emulated, tmp_path: Path) -> None:
    with Relay(drone.uri, loss=0.05) as relay:
        plant = crazyflie(uri=relay.uri, cache=str(tmp_path))
        drive(plant.prepare())
        plant.close()
    asked = len(relay.questions)
    assert len(list(tmp_path.glob("*.json"))) == 2  # the tables of variables and of parameters
    with Relay(drone.uri, loss=0.0) as relay:
        plant = crazyflie(uri=relay.uri, cache=str(tmp_path))
        drive(plant.prepare())
        plant.close()
    assert asked > 2 * len(relay.questions)  # by then the tables are in the cache


def test_giving_up_while_it_connects_leaves_nothing_behind() -> None:
    before = threading.active_count()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        plant = crazyflie(uri=f"udp://127.0.0.1:{silent.getsockname()[1]}")
        phase = plant.prepare()
        next(iter(phase))
        phase.close()  # type: ignore[attr-defined]
        plant.close()
        until(lambda: threading.active_count() <= before, "its threads have ended", 10)


def test_a_sound_drone_passes(drone: Emulated, cache: Path) -> None:
    found = checks(drone, cache, begin="placed")
    assert list(found) == ["battery", "link", "base stations", "estimator", "heading", "start", "supervisor"]
    assert [check.problem for check in found.values()] == [""] * 7
    assert found["battery"].value == "4.10 V"
    assert found["link"].value.endswith("ms there and back")
    assert found["base stations"].value == "2 base stations"
    assert found["start"].value in ("0.09 m away", "0.10 m away", "0.11 m away")
    assert found["supervisor"].value == "can be armed"


def test_heading_is_told(emulator: Emulated, cache: Path) -> None:
    emulator.renew(0.0, 0.0, 90.0)
    assert checks(emulator, cache)["heading"] == Check("heading", "90 deg")


def test_a_low_battery_is_a_problem(drone: Emulated, cache: Path) -> None:
    drone.say("battery 3.5")
    assert checks(drone, cache)["battery"] == Check("battery", "3.50 V", "at least 3.7 V is needed")


def test_missing_base_stations_are_a_problem(drone: Emulated, cache: Path) -> None:
    drone.say("base-stations 0")
    found = checks(drone, cache)
    assert found["base stations"].value == "0 base stations"
    assert "geometry" in found["base stations"].problem
    assert "at most 0.001 m² is allowed" in found["estimator"].problem


def test_a_drone_that_refuses_to_be_armed_is_a_problem(drone: Emulated, cache: Path) -> None:
    drone.say("refuse-arm on")
    drone.say("restart")
    found = checks(drone, cache)["supervisor"]
    assert found.value == "cannot be armed"
    assert found.problem


def test_a_drone_upside_down_is_a_problem(drone: Emulated, cache: Path) -> None:
    drone.say("tumble on")
    assert checks(drone, cache)["supervisor"] == Check("supervisor", "tumbled", "set it upright and restart it")


def test_a_drone_that_is_placed_has_to_stand_at_its_start(drone: Emulated, cache: Path) -> None:
    far = checks(drone, cache, begin="placed", start=(0.5, 0.0))["start"]
    assert far.value.endswith(" m away")
    assert "at most 0.15 m is allowed where begin is 'placed'" in far.problem


def test_a_drone_that_does_not_get_armed_is_an_error(drone: Emulated, cache: Path) -> None:
    drone.say("refuse-arm on")
    drone.say("restart")
    plant = crazyflie(uri=drone.uri, cache=str(cache))
    try:
        drive(plant.prepare())
        with pytest.raises(PlantError, match=r"^agent 2: it was not armed within 3 s: it refuses$"):
            drive(plant.arm())
    finally:
        plant.close()
    assert "armed" not in drone.events


def test_it_does_not_come_back_into_a_run() -> None:
    with pytest.raises(PlantError, match=r"^agent 2: a Crazyflie cannot come back into a run: "):
        crazyflie().resume(State(np.zeros(3), np.zeros(3)), 0)


def test_what_is_not_connected_can_be_closed_and_stopped() -> None:
    plant = crazyflie()
    plant.emergency_stop()
    assert drive(plant.finish(0, "stopped")) < 1
    plant.close()
    plant.close()
    with pytest.raises(PlantError, match="agent 2: it is not connected"):
        plant.sense(0)
