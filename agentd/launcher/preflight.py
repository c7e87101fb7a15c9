"""``agentd preflight``: the bodies of a fleet, looked at before a flight, all at once."""

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
    """What was found at one agent.

    Attributes:
        agent: Id.
        checks: What was looked at.
        failure: Why it could not be looked at; empty if it was.
    """

    agent: int
    checks: tuple[Check, ...] = ()
    failure: str = ""

    @property
    def problems(self) -> list[str]:
        """One line for each thing that keeps the agent on the ground."""
        bad = [check for check in self.checks if check.problem]
        found = [f"agent {self.agent}: {check.name} {check.value}: {check.problem}" for check in bad]
        return [self.failure, *found] if self.failure else found


def inspect(fleet: LoadedFleet) -> list[Inspection]:
    """Connect to all bodies, look at them, and let them go.

    They take their time together: a body waits by itself while others are looked at.

    Raises:
        PluginError: The options of a plant are not usable.
    """
    blueprint = Blueprint.of(fleet)
    plants = {agent: blueprint.plant(agent) for agent in fleet.spec.ids}
    found: dict[int, Inspection] = {}
    with ExitStack() as stack:
        for plant in plants.values():
            stack.callback(plant.close)
        waiting = [(0.0, agent, _look_at(agent, plant)) for agent, plant in plants.items()]
        while waiting:
            waiting.sort(key=lambda each: each[:2])
            due, agent, steps = waiting.pop(0)
            time.sleep(max(0.0, due - time.monotonic()))  # as long as the plant asked for
            try:
                waiting.append((time.monotonic() + next(steps), agent, steps))
            except StopIteration:
                found[agent] = Inspection(agent, plants[agent].checks())
            except DcfError as error:
                found[agent] = Inspection(agent, failure=str(error))
    return [found[agent] for agent in sorted(found)]


def table(fleet: str, found: list[Inspection]) -> Table:
    """What was found, one row for each agent."""
    names = list(dict.fromkeys(check.name for each in found for check in each.checks))
    drawn = Table("agent", *names, "", title=f"{fleet}: before the flight", title_justify="left", box=box.SIMPLE_HEAD)
    for each in found:
        values = {check.name: f"{check.value} !" if check.problem else check.value for check in each.checks}
        verdict = "not ready" if each.problems else "ready" if each.checks else "simulated: nothing to look at"
        drawn.add_row(str(each.agent), *(values.get(name, "") for name in names), verdict)
    return drawn


def _look_at(agent: int, plant: Plant) -> Iterator[float]:
    """Connect to a body and inspect it; yields how long to wait, s."""
    for name, phase in (("prepare", plant.prepare), ("inspect", plant.inspect)):
        with blaming(PlantError, f"agent {agent}: {name}"):
            yield from phase() or ()
