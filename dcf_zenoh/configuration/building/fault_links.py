"""From the faults of a fleet file to those of its links."""

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
    """The links to one agent that have any fault, by sender.

    Args:
        spec: The fleet.
        folder: What the paths of plug-ins and files are relative to.
        graph: Who hears whom.
        receiver: Id.

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
        folder: What the paths of plug-ins and files are relative to.

    Raises:
        PluginError: It cannot be loaded, or refuses its options.
    """
    if not fault:
        return None
    table = spelled_out("faults", fault.model_dump(), folder, run=True)
    return Recipe.of(name, FaultTable.model_validate(table), folder).make(sender, receiver)


def window_of(rule: FaultRule) -> tuple[float, float]:
    """Begin and end of the instants at which messages enter the link, in ns."""
    return ALWAYS if rule.during is None else (nanoseconds(rule.during[0]), nanoseconds(rule.during[1]))


def can_lose(spec: FleetSpec, folder: Path) -> bool:
    """Whether messages can get lost: by a fault of a link, or because an agent is not there to send them.

    Raises:
        PluginError: A fault cannot be loaded.
    """
    absent = any(own.faults.crash or own.faults.pause for own in spec.agents.values())
    return absent or any(getattr(plugin, "LOSES", True) for plugin in _plugins(spec, folder))


def needs_positions(spec: FleetSpec, folder: Path) -> bool:
    """Whether any fault has to know where agents are.

    Raises:
        PluginError: A fault cannot be loaded.
    """
    return any(getattr(plugin, "NEEDS_POSITIONS", False) for plugin in _plugins(spec, folder))


def margin_of(spec: FleetSpec, folder: Path) -> int:
    """Rounds between announcing the end of a step and leaving it: what the file says, or what loss asks for.

    Where rounds time out, what is late is lost for its round: by any fault of a link, by computing that takes long, and
    on the wall clock always.

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
        name: Of the fault, for messages.
        plugin: What makes it.
        values: Of its keys.
        folder: What the paths of files are relative to.
        asked: Names of what it wants to know of the link.
    """

    name: str
    plugin: Plugin
    values: Mapping[str, Any]
    folder: Path
    asked: tuple[str, ...]

    @classmethod
    def of(cls, name: str, table: FaultTable, folder: Path) -> "Recipe":
        """Load the plug-in and convert the keys.

        Raises:
            PluginError: It cannot be loaded, or the keys do not fit.
        """
        plugin = load("faults", table.kind, folder)
        values, errors = check_options(plugin, table.options, name)
        errors += [f"{name}: {text}" for text in check_signature("faults", plugin)]
        if errors:
            raise PluginError(errors)
        return cls(name, plugin, values, folder, tuple(positional(plugin)))

    @property
    def asks_for_link(self) -> bool:
        """Whether it need not be the same on all links."""
        return not {"link", "sender", "receiver"}.isdisjoint(self.asked)

    def make(self, sender: int, receiver: int) -> Fault:
        """The fault of one link.

        Raises:
            PluginError: The constructor refused the options, or made something else; an exception of its is the cause.
        """
        link = FaultLink(sender, receiver, self.folder)
        context = {"link": link, **link._asdict()}
        try:
            fault = self.plugin(*(context[name] for name in self.asked), **self.values)
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
