"""``agentd preflight``: inspect the bodies of a fleet before a flight, all at the same time."""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

from rich import box
from rich.table import Table

from dcf_zenoh.assembly import Blueprint
from dcf_zenoh.config import LoadedFleet
from dcf_zenoh.errors import DcfError, PlantError, blaming
from dcf_zenoh.plant import Check, Plant


@dataclass(frozen=True)
class Inspection:
    """Result of the inspection of one agent's body.

    Attributes:
        agent: Id of the agent.
        checks: Checks of the body; empty where there is nothing to check, as for simulated bodies.
        failure: Why the body could not be inspected; empty if it could.
    """

    agent: int
    checks: tuple[Check, ...] = ()
    failure: str = ""

    @property
    def problems(self) -> list[str]:
        """Reasons why the agent cannot fly, one line each."""
        failed = [check for check in self.checks if check.problem]
        lines = [f"agent {self.agent}: {check.name} {check.value}: {check.problem}" for check in failed]
        return [self.failure, *lines] if self.failure else lines


def inspect(fleet: LoadedFleet) -> list[Inspection]:
    """Connect to all bodies, inspect them, and disconnect; return one inspection per agent, sorted by id.

    The inspections are interleaved in one thread: while one body waits, others are served.

    Raises:
        PluginError: A plant refuses its options.
    """
    blueprint = Blueprint.of(fleet)
    plants = {agent: blueprint.plant(agent) for agent in fleet.spec.ids}
    inspections: dict[int, Inspection] = {}
    with ExitStack() as stack:
        for plant in plants.values():
            stack.callback(plant.close)
        waiting = [(0.0, agent, _inspect_body(agent, plant)) for agent, plant in plants.items()]
        while waiting:
            waiting.sort(key=lambda each: each[:2])
            due, agent, steps = waiting.pop(0)
            time.sleep(max(0.0, due - time.monotonic()))
            try:
                waiting.append((time.monotonic() + next(steps), agent, steps))
            except StopIteration:
                inspections[agent] = Inspection(agent, plants[agent].checks())
            except DcfError as error:
                inspections[agent] = Inspection(agent, failure=str(error))
    return [inspections[agent] for agent in sorted(inspections)]


def inspection_table(fleet: str, inspections: list[Inspection]) -> Table:
    """Return a table with one row per agent and one column per check.

    Args:
        fleet: Name of the fleet.
        inspections: Rows of the table.
    """
    names = list(dict.fromkeys(check.name for each in inspections for check in each.checks))
    table = Table("agent", *names, "", title=f"{fleet}: before the flight", title_justify="left", box=box.SIMPLE_HEAD)
    for each in inspections:
        values = {check.name: f"{check.value} !" if check.problem else check.value for check in each.checks}
        verdict = "not ready" if each.problems else "ready" if each.checks else "simulated: nothing to look at"
        table.add_row(str(each.agent), *(values.get(name, "") for name in names), verdict)
    return table


def _inspect_body(agent: int, plant: Plant) -> Iterator[float]:
    """Connect to a body and inspect it; yield how long to wait each time, s."""
    for name, phase in (("prepare", plant.prepare), ("inspect", plant.inspect)):
        with blaming(PlantError, f"agent {agent}: {name}"):
            yield from phase() or ()
