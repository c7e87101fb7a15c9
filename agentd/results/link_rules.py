"""Measured loss and latency of links, as fault rules of a fleet file that reproduce them."""

import sys
from collections.abc import Collection, Iterable, Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeAlias

from agentd.fault_rules import rules_to_toml, short_ids
from dcf_zenoh.analysis.link_health import LinkHealth
from dcf_zenoh.config import LoadedFleet, graph_of
from dcf_zenoh.errors import RecordingError
from dcf_zenoh.faults.profile import write_profile
from dcf_zenoh.graph import Graph
from dcf_zenoh.records.run import Run

_DECIMALS = 4  # decimals of mean lengths of bursts
_MOST_LOSS = 0.9999  # largest loss by bursts

Rule: TypeAlias = dict[str, Any]
Link: TypeAlias = tuple[int, int]
Ids: TypeAlias = tuple[int, ...] | None


def export_links(run: Run, health: Sequence[LinkHealth], file: Path) -> str:
    """Write the profile of a run, report it on standard error, and return lines of a fleet file that reproduce it.

    Args:
        run: The run.
        health: Measurements of its links.
        file: File of the profile, for the latencies. It is not written if there are none.

    Raises:
        RecordingError: Nothing was measured, or the file cannot be written.
        DcfError: The topology of the run cannot be drawn.
    """
    profiles = [profile for each in health if (profile := each.profile)]
    known = sum(bool(each.latencies.size or each.lost) for each in health)
    if not known:
        raise RecordingError(
            f"{run.folder or run.name}: there is nothing to export: no latency or loss of any link was recorded"
        )
    graph = graph_of(LoadedFleet(run.fleet, run.home, run.name))
    total = len(graph.links)
    rules = rules_to_toml(replay_rules(health, file, graph))
    lines = f"\n# Links as measured in {run.fleet.name}, {run.name}.\n{rules}"
    if profiles:
        try:
            write_profile(file, profiles)
        except OSError as error:
            raise RecordingError(f"{file}: cannot be written: {error.strerror}") from error
        _say(f"{file}: profile of {len(profiles)} of {total} links")
        _say("a fleet file looks for it beside itself, unless its path is absolute")
    else:
        _say(f"{file}: not written, as no latency of any link was recorded")
    if known < total:
        _say(f"no rule is for {total - known} of {total} links, of which neither latency nor loss was recorded")
    if any(rule.faults for rule in run.fleet.faults.rules):
        _say("this run had faults of its own: put the lines in place of them")
    return lines


def replay_rules(health: Iterable[LinkHealth], file: Path, graph: Graph) -> list[Rule]:
    """Return the rules: for each link at most one for latency and one for loss, none for what was not measured."""
    delayed: list[Link] = []
    lossy: dict[tuple[float, float], list[Link]] = {}
    for each in health:
        link = each.sender, each.receiver
        if each.latencies.size:
            delayed.append(link)
        if each.lost:
            lossy.setdefault(_loss(each), []).append(link)
    rules = _rules({"latency": {"distribution": "empirical", "file": file.as_posix()}}, delayed, graph)
    for (loss, length), links in lossy.items():
        bursts = {"bursts": {"mean_loss": loss, "mean_length": length}}
        rules += _rules(bursts if loss < 1 else {"loss": loss}, links, graph)
    return rules


def _loss(health: LinkHealth) -> tuple[float, float]:
    """Return the share of lost messages and the mean length of bursts; 1 and 0 if no message was received."""
    lost = sum(health.lost.values())
    if lost == health.sent:
        return 1.0, 0.0
    length = max(health.mean_burst, lost / (health.sent - lost))  # there is at least one message between two bursts
    length = round(max(1.0, length), _DECIMALS)
    most = length / (1 + length) - 10**-_DECIMALS
    return float(f"{min(health.loss, most, _MOST_LOSS):.4g}"), length


def _rules(fault: dict[str, Any], links: Collection[Link], graph: Graph) -> list[Rule]:
    """Return rules that give a fault to exactly these links of a graph, once to each."""
    return [
        {key: short_ids(ids) for key, ids in (("from", senders), ("to", receivers)) if ids is not None} | fault
        for senders, receivers in _covers(links, graph)
    ]


def _covers(links: Collection[Link], graph: Graph) -> list[tuple[Ids, Ids]]:
    """Return pairs of senders and receivers that cover exactly these links of a graph; None: all agents."""
    if set(links) == graph.links:
        return [(None, None)]
    by_senders = _grouped(links, graph.links)
    by_receivers = _grouped(map(_turned, links), map(_turned, graph.links))
    return min(by_senders, [(far, near) for near, far in by_receivers], key=_length)


def _grouped(links: Iterable[Link], known: Iterable[Link]) -> list[tuple[Ids, Ids]]:
    """Return the first ends of links, grouped by the agents at the other ends; None: all of the `known` ones."""
    there = _by_first(known)
    alike: dict[Ids, list[int]] = {}
    for agent, others in _by_first(links).items():
        alike.setdefault(None if others == there[agent] else others, []).append(agent)
    return [(tuple(agents), others) for others, agents in alike.items()]


def _length(covers: Collection[tuple[Ids, Ids]]) -> tuple[int, int]:
    """Return the number of rules, and of ids in them."""
    return len(covers), sum(len(ids or ()) for ends in covers for ids in ends)


def _by_first(links: Iterable[Link]) -> dict[int, tuple[int, ...]]:
    return {agent: tuple(other for _, other in group) for agent, group in groupby(sorted(links), itemgetter(0))}


def _turned(link: Link) -> Link:
    return link[1], link[0]


def _say(line: str) -> None:
    print(f"agentd: {line}", file=sys.stderr)
