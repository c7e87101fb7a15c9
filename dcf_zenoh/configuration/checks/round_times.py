"""Checks of rounds against the latency of links: what cannot work is refused, what likely fails is noted."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from dcf_zenoh.configuration.building.fault_links import Recipe
from dcf_zenoh.diagnostics import Diagnostics
from dcf_zenoh.faults.fault import Fault
from dcf_zenoh.graph import Graph
from dcf_zenoh.plugins import is_built_in, load
from dcf_zenoh.spec import FleetSpec


@dataclass(frozen=True)
class _Delay:
    """Delay of the messages of a link by one fault that acts all the time.

    Attributes:
        key: Key of the fault in the fleet file.
        least: Shortest delay of a message, s.
        usual: Typical delay, s.
    """

    key: str
    least: float
    usual: float


_Delays = Mapping[tuple[int, int], _Delay]


def check_round_times(
    spec: FleetSpec, folder: Path, graph: Graph | None, diagnostics: Diagnostics, notes: list[str], losers: list[str]
) -> None:
    """Check that messages can be received in the rounds, and rounds fit into the steps, that need them.

    Args:
        spec: Specification of the fleet; without errors so far, or nothing is checked.
        folder: Folder that paths of files are relative to.
        graph: Communication graph; None if it is not known.
        diagnostics: Errors, to which one may be added.
        notes: Remarks, to which new ones are added.
        losers: Keys of the faults that can lose messages.
    """
    if diagnostics or graph is None or len(spec.agents) < 2:
        return
    flooding = _floods(spec, folder)
    delays = _delays(spec, folder, graph)
    if spec.exchange.mode == "synchronous":
        _check_latency(spec, graph, delays, diagnostics, notes, flooding=flooding)
    if diagnostics:
        return
    _check_diameter(spec, graph, delays, diagnostics, notes, flooding=flooding)
    if flooding and losers:
        first = "round" if graph.diameter == 1 else f"{graph.diameter} rounds"
        notes.append(
            f"{losers[0]}: can lose messages, and controller.sharing = 'flood' needs every message of the first"
            f" {first} of a step: a step without one of them has no setpoint of its own;"
            " controller.sharing = 'piggyback' bears loss"
        )


def _check_latency(
    spec: FleetSpec,
    graph: Graph,
    delays: _Delays,
    diagnostics: Diagnostics,
    notes: list[str],
    *,
    flooding: bool,
) -> None:
    """Compare the latency of each link with the wait of a synchronous round."""
    budget, timeout = spec.exchange.step_budget(spec.time.sample_time), spec.exchange.round_timeout
    if timeout is None or timeout >= budget:
        for (sender, receiver), each in delays.items():
            if each.least > budget:
                diagnostics.add(
                    each.key,
                    f"{each.least:g} s from agent {sender} to {receiver} is longer than the budget of a step,"
                    f" exchange.budget = {budget:g} s, in which every round waits for the message (times are in s)",
                )
                return
        return
    late = {link: each for link, each in delays.items() if each.usual > timeout}
    if not late:
        return
    first = next(iter(late.values()))
    text = f"is longer than exchange.round_timeout = {timeout:g} s"
    deaf = [j for j in graph.agents if all((i, j) in late for i in graph.in_neighbours(j)) and graph.in_neighbours(j)]
    if flooding and any(min(late[i, j].least for i in graph.in_neighbours(j)) > timeout for j in deaf):
        diagnostics.add(
            first.key,
            f"{first.least:g} s {text}, so agent {deaf[0]} receives no state in the rounds that share them"
            " (controller.sharing = 'flood'): raise the time-out",
        )
        return
    links = _counted(len(late), "link")
    notes.append(f"{first.key}: {first.usual:g} s on {links} {text}: messages come too late for their round")


def _check_diameter(
    spec: FleetSpec, graph: Graph, delays: _Delays, diagnostics: Diagnostics, notes: list[str], *, flooding: bool
) -> None:
    """Compare the rounds that sharing states and agreeing need with the budget of a step."""
    budget = spec.exchange.step_budget(spec.time.sample_time)
    sharing = graph.diameter if flooding else 0
    least, usual = _shortest_round(spec, graph, delays)
    if sharing and sharing * least >= budget:
        diagnostics.add(
            "exchange.budget",
            f"sharing the states takes {_counted(sharing, 'round')}, the diameter of the graph, of at least {least:g} s"
            f" each: expected more than {sharing * least:g} s, not {budget:g} s",
        )
        return
    needed = sharing + graph.diameter + 1
    if spec.exchange.mode == "synchronous" and needed * usual >= budget:
        share = f"share states and agree on a graph of diameter {graph.diameter}" if sharing else "agree"
        notes.append(
            f"exchange.budget: {_counted(needed, 'round')} of about {usual:g} s to {share} do not fit into"
            f" {budget:g} s: steps end by time, not by agreement"
        )


def _shortest_round(spec: FleetSpec, graph: Graph, delays: _Delays) -> tuple[float, float]:
    """Return the least and the usual time of a round at the agent that has the shortest, s."""
    rounds = spec.exchange
    if rounds.mode == "asynchronous":
        period = min(spec.activation(i).period or 0.0 for i in graph.agents)
        return period, period
    computing = rounds.compute_time if spec.time.clock == "virtual" else 0.0
    wait = rounds.step_budget(spec.time.sample_time) if rounds.round_timeout is None else rounds.round_timeout
    none = _Delay("", 0.0, 0.0)
    waits = [[delays.get((i, j), none) for i in graph.in_neighbours(j)] for j in graph.agents]
    least = min(min(wait, max((each.least for each in own), default=0.0)) for own in waits)
    usual = min(min(wait, max((each.usual for each in own), default=0.0)) for own in waits)
    return least + computing, usual + computing


def _floods(spec: FleetSpec, folder: Path) -> bool:
    """Return whether the states of all agents are flooded at the beginning of each step."""
    kind = spec.controller_kind
    if kind.kind != "receding_horizon" or kind.options.get("sharing", "flood") != "flood":
        return False
    built_in = is_built_in("problems", spec.problem.kind)
    return built_in and not getattr(load("problems", spec.problem.kind, folder), "local", False)


def _delays(spec: FleetSpec, folder: Path, graph: Graph) -> dict[tuple[int, int], _Delay]:
    """Return the delay of each link on which a built-in fault delays messages from the beginning to the end."""
    found: dict[tuple[int, int], dict[str, _Delay]] = {}
    links = sorted(graph.links)
    for number, rule in enumerate(spec.faults.rules):
        covered = [link for link in links if rule.covers(*link)]
        for name, table in rule.faults.items():
            key = f"faults.rule.{number}.{name}" if number else f"faults.{name}"
            usable = table and rule.during is None and is_built_in("faults", table.kind)
            recipe = Recipe.of(key, table, folder) if table and usable else None
            for link, fault in _made(recipe, covered):
                of_link = found.setdefault(link, {})
                of_link.pop(name, None)  # a later rule wins; one for a while leaves no delay that acts all the time
                if fault is not None and fault.usual_delay:
                    of_link[name] = _Delay(key, fault.least_delay, fault.usual_delay)
    longest = {link: max(each.values(), key=lambda delay: delay.usual) for link, each in found.items() if each}
    return dict(sorted(longest.items(), key=lambda item: -item[1].usual))


def _made(recipe: Recipe | None, links: list[tuple[int, int]]) -> Iterator[tuple[tuple[int, int], Fault | None]]:
    """Yield each link with its fault; one for all links if it depends on none."""
    alike = recipe.make(*links[0]) if recipe and links and not recipe.depends_on_link else None
    for link in links:
        yield link, alike or (recipe.make(*link) if recipe else None)


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
