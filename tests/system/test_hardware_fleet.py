"""Fleets of Crazyflies, flown by real daemons and the real cflib over UDP; the emulator tells what they really did."""

import os
import signal
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple, Self

import pytest

from dcf_zenoh import Run
from tests.support.daemons import PROCESSES, Launch
from tests.support.swarm import Drone, Swarm, launch
from tests.support.waiting import until

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.whole_fleet,
    pytest.mark.skipif(not (PROCESSES / "self").exists(), reason="processes are found in /proc"),
    pytest.mark.timeout(300),
]
LONG = 150.0  # s; a flight takes 15 s on a quiet machine
AT_ONCE = 3  # fleets


class Flight(NamedTuple):
    """What became of a fleet.

    Attributes:
        code: Exit code of the launcher; None: it was killed.
        errors: What it wrote to standard error.
        run: What the agents recorded.
        drones: Agent -> its drone.
    """

    code: int | None
    errors: str
    run: Run
    drones: Mapping[int, Drone]


def kill_link(swarm: Swarm, first: int, flight: Launch) -> None:
    flight.flying()
    swarm.send(first, "kill-link")


def kill_daemon(_swarm: Swarm, _first: int, flight: Launch) -> None:
    os.kill(flight.flying()[1], signal.SIGKILL)


def kill_launcher(_swarm: Swarm, _first: int, flight: Launch) -> None:
    flight.flying()
    flight.process.kill()
    until(lambda: not flight.daemons(), "all daemons have ended", LONG)


def drift_away(swarm: Swarm, first: int, flight: Launch) -> None:
    flight.flying()
    swarm.send(first, "drift 1.5 0.0")
    until(lambda: flight.process.poll() is not None or "outside the arena" in flight.errors, "it is noticed", LONG)
    swarm.send(first, "drift 0.0 0.0")


def sink_battery(swarm: Swarm, first: int, flight: Launch) -> None:
    flight.flying()
    swarm.send(first, "battery 2.9")


def nothing(_swarm: Swarm, _first: int, _flight: Launch) -> None:
    """The trouble was made before."""


# Name -> before the launch, in flight, more of the fleet file. Agent 1 has the trouble.
TROUBLE: Mapping[str, tuple[str, Callable[[Swarm, int, Launch], None], str]] = {
    "link dead": ("", kill_link, ""),
    "daemon killed": ("", kill_daemon, ""),
    "launcher killed": ("", kill_launcher, ""),
    "geofence": ("", drift_away, "[arena]\nmin = [-0.5, -1.5]\nmax = [0.5, 1.5]\n"),
    "battery low": ("", sink_battery, ""),
    "not ready": ("battery 3.5", nothing, ""),
}


def fly(swarm: Swarm, folder: Path, first: int, name: str) -> Flight:
    """Fly two drones, and let agent 1 get into trouble."""
    before, trouble, more = TROUBLE[name]
    fleet = swarm.fleet(folder, (first, first + 1), more)
    if before:
        swarm.send(first, before)
    with launch(fleet) as flight:
        trouble(swarm, first, flight)
        code = None if name == "launcher killed" else flight.end(LONG)
        drones = {1: swarm.drones[first], 2: swarm.drones[first + 1]}
        return Flight(code, flight.errors, Run.read(flight.folder), drones)


PHASES = ("prepare", "inspect", "arm", "take off", "settle", "go to start", "run", "landing")


def interrupt(swarm: Swarm, folder: Path, number: int, phase: str) -> Flight:
    """Press Ctrl-C in a phase of a flight of one drone."""
    fleet = swarm.fleet(folder, (number,))
    if phase == "go to start":
        swarm.send(number, "place 0.7 0.7")  # far enough from its start for the way to take a while
    drone = swarm.drones[number]
    with launch(fleet, *(["time.duration=0.6"] if phase == "landing" else [])) as flight:
        if phase == "arm":
            until(lambda: "arm" in drone.orders, "it is armed", LONG)
        elif phase == "run":
            flight.flying(agents_at_least=1)
        else:
            said = "landing" if phase == "landing" else f"getting ready: {phase}"
            until(lambda: f"all agents: {said}" in flight.errors, said, LONG)
        flight.process.send_signal(signal.SIGINT)
        code = flight.end(LONG)
        return Flight(code, flight.errors, Run.read(flight.folder), {1: drone})


def fly_mixed(swarm: Swarm, folder: Path, number: int, _name: str) -> Flight:
    """Fly one drone and one point mass."""
    point = '[plants.point]\nkind = "point_mass"\n'
    second = '[agents.2]\nplant = "point"\nstart = [0.0, -0.7]\ntarget = [0.0, -0.7]\n'
    fleet = swarm.fleet(folder, (number,), point + second)
    with launch(fleet, "time.duration=1.0", "plant='hardware'") as flight:
        code = flight.end(LONG)
        return Flight(code, flight.errors, Run.read(flight.folder), {1: swarm.drones[number]})


# Name -> number of drones, what flies them.
PLANS: Mapping[str, tuple[int, Callable[[Swarm, Path, int, str], Flight]]] = {
    **dict.fromkeys(TROUBLE, (2, fly)),
    "mixed": (1, fly_mixed),
    **dict.fromkeys(PHASES, (1, interrupt)),
}


class Flights:
    """Flights of two swarms, some at a time. A flight asked for twice is flown once more, in a swarm of its own.

    One swarm has the fleets of two drones, one those of a single drone: an emulator has one thread.

    Args:
        folder: Directory for what they write.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._stack = ExitStack()
        names = {size: [name for name, (drones, _) in PLANS.items() if drones == size] for size in (2, 1)}
        swarms = {
            size: self._stack.enter_context(Swarm(folder / f"truth-{size}", size * len(names[size]))) for size in names
        }
        pool = self._stack.enter_context(ThreadPoolExecutor(AT_ONCE))
        self._flights: dict[str, Future[Flight]] = {}
        for name, (size, flown) in PLANS.items():
            first = 1 + size * names[size].index(name)
            self._flights[name] = pool.submit(flown, swarms[size], folder / name.replace(" ", "_"), first, name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def __getitem__(self, name: str) -> Flight:
        """Return what became of one of them."""
        flight = self._flights.pop(name, None)
        if flight is not None:
            return flight.result(2 * LONG)
        folder = Path(tempfile.mkdtemp(dir=self._folder))
        size, flown = PLANS[name]
        with Swarm(folder / "truth", size) as swarm:
            return flown(swarm, folder / "again", 1, name)


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flights]:
    with Flights(tmp_path_factory.mktemp("fleets")) as flights:
        yield flights


def end_of(flight: Flight, agent: int) -> tuple[str, str]:
    end = flight.run.agents[agent].end
    assert end is not None
    return end["end"], end["remark"]


def test_drone_whose_link_dies_is_stopped_by_its_firmware_and_the_others_land(flights: Flights) -> None:
    flight = flights["link dead"]
    assert flight.code == 1
    reason, why = end_of(flight, 1)
    assert reason == "failed"
    assert "state is" in why
    one = flight.drones[1]
    assert one.lost_control >= {"levelling out", "free fall", "locked"}
    assert one.time_of("free fall") - one.time_of("levelling out") == pytest.approx(1.5, abs=0.2)
    assert flight.drones[2].landed_softly
    assert "neighbour 1 is lost" in end_of(flight, 2)[1]


def test_when_a_daemon_is_killed_only_the_firmware_watches_over_its_drone_and_the_others_land(flights: Flights) -> None:
    flight = flights["daemon killed"]
    assert flight.code == 1
    assert "agent 1 was killed by SIGKILL" in flight.errors
    one = flight.drones[1]
    levelled = one.time_of("levelling out")
    last_order = max(record.time for record in one.truth if record.kind == "command")
    assert levelled - last_order == pytest.approx(0.5, abs=0.1)
    assert one.time_of("free fall") - last_order == pytest.approx(2.0, abs=0.1)
    assert "locked" in one.events
    assert flight.drones[2].landed_softly


def test_when_the_launcher_is_killed_all_drones_land(flights: Flights) -> None:
    flight = flights["launcher killed"]
    for agent, drone in flight.drones.items():
        assert drone.landed_softly
        assert end_of(flight, agent) == ("stopped", "stopped by the launcher's end")


def test_drone_that_leaves_the_arena_lands_and_says_where_it_was(flights: Flights) -> None:
    flight = flights["geofence"]
    assert flight.code == 1
    reason, why = end_of(flight, 1)
    assert reason == "landed"
    assert "outside the arena: x = 0." in why
    (alarm,) = (event for event in flight.run.agents[1].events if event["event"] == "alarm")
    assert (alarm["rule"], alarm["then"]) == ("geofence", "land")
    assert flight.drones[1].landed_softly
    assert flight.drones[2].landed_softly
    assert end_of(flight, 2) == ("landed", end_of(flight, 2)[1])
    assert "neighbour 1 is lost (it has landed)" in end_of(flight, 2)[1]


def test_drone_with_a_low_battery_lands_and_says_so(flights: Flights) -> None:
    flight = flights["battery low"]
    assert flight.code == 1
    assert "battery" in end_of(flight, 1)[1]
    assert "at least 3.1 V" in end_of(flight, 1)[1]
    assert flight.drones[1].landed_softly
    assert flight.drones[2].landed_softly


def test_one_drone_that_is_not_ready_keeps_all_on_the_ground(flights: Flights) -> None:
    flight = flights["not ready"]
    assert flight.code == 1
    assert "agent 1: not ready to fly: battery 3.50 V: " in flight.errors
    for drone in flight.drones.values():
        assert not {"arm", "take_off"} & set(drone.orders)
        assert "armed" not in drone.events


@pytest.mark.parametrize("phase", PHASES)
def test_ctrl_c_leaves_every_drone_on_the_ground(phase: str, flights: Flights) -> None:
    flight = flights[phase]
    assert flight.code == 130
    drone = flight.drones[1]
    assert not drone.lost_control
    if phase in ("prepare", "inspect"):
        assert "armed" not in drone.events
    elif "took off" in drone.events:
        assert drone.landed_softly
    else:
        assert phase in ("arm", "take off")
        assert "disarmed" in drone.events
    if phase != "prepare":
        end = flight.run.agents[1].end
        assert end is not None
        assert end["end"] == ("done" if phase == "landing" else "stopped")


def test_one_drone_and_one_point_mass_fly_in_one_fleet(flights: Flights) -> None:
    flight = flights["mixed"]
    assert flight.code == 0, flight.errors
    assert flight.drones[1].landed_softly
    assert flight.run.complete
    assert {len(log.step) for log in flight.run.agents.values()} == {5}


@pytest.mark.parametrize(
    "radio",
    [
        pytest.param((), id="good radio", marks=pytest.mark.large),
        pytest.param(("--tail", "0.02", "--silences", "20"), id="bad radio"),
    ],
)
def test_four_drones_change_places_and_land(radio: tuple[str, ...], tmp_path: Path) -> None:
    with Swarm(tmp_path / "truth", 4, *radio) as swarm:
        uris = [f"agents.{i}.plants.hardware.uri='{drone.uri}'" for i, drone in swarm.drones.items()]
        changes = [
            *uris,
            f"plants.hardware.connection.cache='{tmp_path}'",
            "plants.hardware.connection.retries=25",
            "time.arrived.within=0.1",
            "plant='hardware'",
        ]
        with Launch("position_swap", tmp_path / "run", *changes, yes=True) as flight:
            assert flight.end(LONG) == 0, flight.errors
            summary = flight.summary
        assert summary["arrived"], summary
        assert set(summary["alarms"]) <= {"separation"}  # by some mm: with Lighthouse the plans have no margin
        assert summary["min_distance"] > 0.15
        run = Run.read(flight.folder)
        assert run.complete
        for drone in swarm.drones.values():
            assert drone.landed_softly
            assert drone.orders.count("arm") >= 1
