"""Several software Crazyflies in one process, and fleets of daemons that fly them."""

from pathlib import Path

from plants.crazyflie.emulator.truth import Record, read_truth
from tests.support.daemons import Launch
from tests.support.emulator_process import EmulatorProcess
from tests.support.small_fleet import small_fleet

PLACES = ([0.0, 0.7], [0.0, -0.7])


class Drone:
    """One of a swarm.

    Args:
        path: File with the truth.
        uri: Where it listens.
    """

    def __init__(self, path: Path, uri: str) -> None:
        self._path = path
        self.uri = uri

    @property
    def truth(self) -> list[Record]:
        """What it did and was told."""
        return read_truth(self._path)

    @property
    def events(self) -> list[str]:
        """What happened to it, in order."""
        return [record["event"] for record in self.truth if record.kind == "event"]

    @property
    def orders(self) -> list[str]:
        """What it was told, in order."""
        return [record["command"] for record in self.truth if record.kind == "command"]

    def time_of(self, event: str) -> float:
        """When something happened to it first, s."""
        return next(record.time for record in self.truth if record.kind == "event" and record["event"] == event)

    @property
    def lost_control(self) -> set[str]:
        """What happened to it that must not."""
        return {"levelling out", "free fall", "locked", "crashed", "emergency stop"} & set(self.events)

    @property
    def landed_softly(self) -> bool:
        """It came down with its motors running, in control, and they are off."""
        touched = [
            record["soft"] for record in self.truth if record.kind == "event" and record["event"] == "touched down"
        ]
        return bool(touched) and all(touched) and not self.lost_control and "disarmed" in self.events


class Swarm(EmulatorProcess):
    """The drones of ``agentd emulate-crazyflie``. Use it in a ``with`` statement.

    Args:
        folder: Where it writes the truth.
        count: How many drones.
        options: Other options of the command.
    """

    def __init__(self, folder: Path, count: int, *options: str) -> None:
        super().__init__(folder, count, *options)
        self.drones = {number: Drone(folder / f"drone-{number}.jsonl", uri) for number, uri in self.uris.items()}

    def fleet(self, folder: Path, drones: tuple[int, ...], more: str = "") -> Path:
        """A fleet file whose agents 1, 2, ... are these drones, which are put at their starts."""
        folder.mkdir(parents=True)
        agents = {}
        for agent, drone in enumerate(drones, 1):
            place = PLACES[agent - 1]
            self.send(drone, f"place {place[0]} {place[1]}")
            uri = {"plants": {"hardware": {"uri": self.drones[drone].uri}}}
            agents[str(agent)] = {
                "start": place,
                "target": place,
                **uri,
            }  # what is tested is the flight around the loop
        text = small_fleet(
            "hovering",
            plant=None,
            time={"clock": "wall", "duration": 60.0},
            exchange={"max_rounds": 4, "budget": 0.1},  # little work for the machine
            plants={
                "hardware": {
                    "kind": "crazyflie_hardware",
                    "connection": {"cache": str(folder.parent / "tables"), "retries": 25},  # the machine may be busy
                    "watchdog": {"state_age_max": 1.5},
                }
            },
            agents=agents,
        )
        (folder / "hovering.toml").write_text(text + more)
        return folder / "hovering.toml"


def launch(fleet: Path, *changes: str) -> Launch:
    """Launch a fleet; its run directory is beside its file."""
    return Launch(fleet, fleet.parent / "run", *changes, yes=True, quiet=False)
