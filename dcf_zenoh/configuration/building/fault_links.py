"""Fault chains of the links of a fleet, and properties of all its faults."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dcf_zenoh.diagnostics import reason
from dcf_zenoh.errors import PluginError
from dcf_zenoh.faults.chain import ALWAYS, FaultChain, Layer
from dcf_zenoh.faults.fault import Fault, FaultLink, Stage
from dcf_zenoh.graph import Graph
from dcf_zenoh.plugins import Plugin, check_options, check_signature, load, positional, spelled_out
from dcf_zenoh.plugins.schema import name_of
from dcf_zenoh.spec import FaultRule, FaultTable, FleetSpec, Switch, nanoseconds

MARGIN_WITH_LOSS = 3  # rounds


def links_to(spec: FleetSpec, folder: Path, graph: Graph, receiver: int) -> dict[int, FaultChain]:
    """Return the fault chains of the links to one agent, by sender; links without faults are left out.

    Args:
        spec: Specification of the fleet.
        folder: Folder that paths of plug-ins and files are relative to.
        graph: Communication graph.
        receiver: Id of the receiving agent.

    Raises:
        PluginError: A fault cannot be loaded, or refuses its options.
    """
    rules = []
    for rule in spec.faults.rules:
        if any(rule.covers(sender, receiver) for sender in graph.in_neighbours(receiver)):
            recipes = {name: table and Recipe.of(name, table, folder) for name, table in rule.faults.items()}
            rules.append((rule, window_of(rule), recipes))
    links = {}
    for sender in graph.in_neighbours(receiver):
        layers: dict[str, Layer] = {}
        for rule, window, recipes in rules:
            for name, recipe in recipes.items() if rule.covers(sender, receiver) else ():
                fault = recipe.make(sender, receiver) if recipe else None
                layers.setdefault(name, Layer(name)).entries.append((window, fault))
        if any(fault is not None for layer in layers.values() for _, fault in layer.entries):
            links[sender] = FaultChain(spec.seed, sender, receiver, layers.values())
    return links


def fault_of(name: str, fault: Switch, sender: int, receiver: int, folder: Path) -> Fault | None:
    """Return one fault for one link, to be added to a link of a running fleet; None if it is switched off.

    Args:
        name: Name of the fault, for messages.
        fault: Its table, in which a bare `value` stands for the first key, as in a fleet file.
        sender: Id of the sending agent.
        receiver: Id of the receiving agent.
        folder: Folder that paths of plug-ins and files are relative to.

    Raises:
        PluginError: The fault cannot be loaded, or refuses its options.
    """
    if not fault:
        return None
    table = spelled_out("faults", fault.model_dump(), folder, run=True)
    return Recipe.of(name, FaultTable.model_validate(table), folder).make(sender, receiver)


def window_of(rule: FaultRule) -> tuple[float, float]:
    """Return begin and end of the instants at which a rule acts on entering messages, in ns."""
    return ALWAYS if rule.during is None else (nanoseconds(rule.during[0]), nanoseconds(rule.during[1]))


def can_lose(spec: FleetSpec, folder: Path) -> bool:
    """Return whether messages can get lost: by a fault of a link, or by a crash or pause of their sender.

    Raises:
        PluginError: A fault cannot be loaded.
    """
    absent = any(own.faults.crash or own.faults.pause for own in spec.agents.values())
    return absent or any(getattr(plugin, "LOSES", True) for plugin in _plugins(spec, folder))


def needs_positions(spec: FleetSpec, folder: Path) -> bool:
    """Return whether any fault needs the positions of agents.

    Raises:
        PluginError: A fault cannot be loaded.
    """
    return any(getattr(plugin, "NEEDS_POSITIONS", False) for plugin in _plugins(spec, folder))


def margin_of(spec: FleetSpec, folder: Path) -> int:
    """Return the number of rounds between announcing the end of a step and leaving it.

    It is the value of the file. Without one it is `MARGIN_WITH_LOSS` if messages can get lost or be too late for their
    round, else 0; in asynchronous mode it is 0. With a time-out of rounds, messages can be too late because of any
    fault of a link or an agent, of computation time, and always on the wall clock.

    Raises:
        PluginError: A fault cannot be loaded.
    """
    if spec.exchange.margin is not None:
        return spec.exchange.margin
    if spec.exchange.mode == "asynchronous":
        return 0
    delays = (
        spec.time.clock == "wall"
        or spec.exchange.compute_time > 0
        or any(own.faults for own in spec.agents.values())
        or any(fault for rule in spec.faults.rules for fault in rule.faults.values())
    )
    times_out = spec.exchange.round_timeout is not None and delays
    return MARGIN_WITH_LOSS if times_out or can_lose(spec, folder) else 0


@dataclass(frozen=True)
class Recipe:
    """A fault of a fleet file, to be made for any number of links.

    Attributes:
        name: Name of the fault, for messages.
        plugin: Class or function that makes the fault.
        values: Values of its keyword-only arguments.
        folder: Folder that paths of files are relative to.
        arguments: Names of its positional arguments.
    """

    name: str
    plugin: Plugin
    values: Mapping[str, Any]
    folder: Path
    arguments: tuple[str, ...]

    @classmethod
    def of(cls, name: str, table: FaultTable, folder: Path) -> "Recipe":
        """Load the plug-in and convert the keys.

        Raises:
            PluginError: The plug-in cannot be loaded, or its keys do not fit.
        """
        plugin = load("faults", table.kind, folder)
        values, errors = check_options(plugin, table.options, name)
        errors += [f"{name}: {text}" for text in check_signature("faults", plugin)]
        if errors:
            raise PluginError(errors)
        return cls(name, plugin, values, folder, tuple(positional(plugin)))

    @property
    def depends_on_link(self) -> bool:
        """Whether the fault can differ from link to link."""
        return not {"link", "sender", "receiver"}.isdisjoint(self.arguments)

    def make(self, sender: int, receiver: int) -> Fault:
        """Make the fault of one link.

        Raises:
            PluginError: The constructor refused the options (its exception is the cause), or did not make a fault.
        """
        link = FaultLink(sender, receiver, self.folder)
        context = {"link": link, **link._asdict()}
        try:
            fault = self.plugin(*(context[name] for name in self.arguments), **self.values)
        except Exception as error:
            raise PluginError(f"{self.name}: {name_of(self.plugin)} refused its options: {reason(error)}") from error
        if not isinstance(fault, Fault):
            raise PluginError(f"{self.name}: {name_of(self.plugin)} made a {type(fault).__name__}, not a Fault")
        if not isinstance(fault.STAGE, Stage):
            raise PluginError(f"{self.name}: STAGE of {name_of(self.plugin)} must be a Stage, not {fault.STAGE!r:.40}")
        return fault


def _plugins(spec: FleetSpec, folder: Path) -> Iterator[Plugin]:
    for rule in spec.faults.rules:
        for fault in rule.faults.values():
            if fault:
                yield load("faults", fault.kind, folder)
