"""What was changed on the links of a fleet while it ran: when each change acted, as a table and as rules."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from agentd.daemon.operator_protocol import Change, Done, changes_in
from dcf_zenoh.configuration.building.fault_links import window_of
from dcf_zenoh.records.run import Run
from dcf_zenoh.spec import FaultRule, FleetSpec, Switch


class FaultPeriod(NamedTuple):
    """One change on links to one agent, and when it acted.

    Attributes:
        senders: Whose links.
        receiver: The agent.
        name: Of the fault.
        fault: Its table; False: none acted.
        begin: Fleet time, ns.
        end: None if it was not ended.
    """

    senders: tuple[int, ...]
    receiver: int
    name: str
    fault: Switch
    begin: int
    end: int | None

    def on(self, sender: int, receiver: int) -> bool:
        """Whether it is one of the link ``sender -> receiver``."""
        return receiver == self.receiver and sender in self.senders


def stretches(receiver: int, changes: Sequence[Done]) -> list[FaultPeriod]:
    """When each of the changes on the links to an agent acted, in the order in which they were made."""
    acting: dict[tuple[int, str], int] = {}  # sender, name -> which change
    ends: dict[tuple[int, int], int | None] = {}  # which change, sender -> its end
    for number, (time, what) in enumerate((done.time, done.change) for done in changes):
        for j in what.senders:
            name = what.name if isinstance(what, Change) else None
            for key in [key for key in acting if key[0] == j and name in (None, key[1])]:
                ends[acting.pop(key), j] = time
            if name is not None:
                acting[j, name] = number
                ends[number, j] = None
    found = []
    for number, done in enumerate(changes):
        if isinstance(what := done.change, Change):
            own = {j: ends[number, j] for j in what.senders}
            for end in dict.fromkeys(own.values()):
                senders = tuple(sorted(j for j in own if own[j] == end))
                found.append(FaultPeriod(senders, receiver, what.name, what.fault, done.time, end))
    return found


def rules(found: Iterable[FaultPeriod], length: float) -> list[dict[str, Any]]:
    """What was changed, as rules for the end of the fleet file; what did not act within `length`, in s, is left out."""
    tables = []
    for stretch in sorted(found, key=lambda each: (each.begin, each.receiver)):
        begin, end = _seconds(stretch.begin), length if stretch.end is None else _seconds(stretch.end)
        if begin < min(end, length):
            ends = {"from": short(stretch.senders), "to": stretch.receiver, "during": [begin, end]}
            tables.append({**ends, stretch.name: stretch.fault and plain(stretch.name, stretch.fault)})
    return tables


def changes_of(run: Run) -> list[FaultRule]:
    """What was changed while a run lasted, as its logs tell, as rules that go over those of its fleet file."""
    found = [each for j, log in run.agents.items() for each in stretches(j, changes_in(log))]
    return [
        FaultRule.model_validate(
            {name: {"kind": name, **each} if isinstance(each, dict) else each for name, each in table.items()}
        )
        for table in rules(found, run.fleet.steps * run.fleet.time.sample_time)
    ]


def to_toml(tables: Iterable[Mapping[str, Any]]) -> str:
    """Rules as they stand in a fleet file."""
    return "\n".join(
        "[[faults.rule]]\n" + "".join(f"{_key(key)} = {inline(value)}\n" for key, value in table.items())
        for table in tables
    )


def overview(
    spec: FleetSpec, links: Iterable[tuple[int, int]], found: Sequence[FaultPeriod], times: Mapping[int, int]
) -> str:
    """For each link what acts, what comes from the fleet file and what was changed, as a table.

    Args:
        spec: The fleet.
        links: Those to show.
        found: What was changed.
        times: Receiver -> what is now, ns.
    """
    rows = [("link", "fault", "acts now", "fleet file", "changed while running")]
    for i, j in links:
        in_file = {name for rule in spec.faults.rules if rule.covers(i, j) for name in rule.faults}
        changed = [each for each in found if each.on(i, j)]
        names = sorted(in_file | {each.name for each in changed})
        for name in names or ["-"]:
            own = [each for each in changed if each.name == name]
            given = _in_file(spec, i, j, name, times[j])
            acting = next((_text(name, each.fault) for each in own if each.end is None), given)
            rows.append((f"{i} -> {j}", name, acting, given, "; ".join(map(_told, own)) or "-"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def plain(name: str, fault: Any) -> dict[str, Any]:
    """The table of a fault, as short as it can be."""
    table: dict[str, Any] = fault.model_dump(exclude_none=True)
    return {key: value for key, value in table.items() if (key, value) != ("kind", name)}


def inline(value: Any) -> str:
    """A value in TOML, on one line."""
    if isinstance(value, Mapping):
        return (
            "{ " + ", ".join(f"{_key(key)} = {inline(each)}" for key, each in value.items()) + " }" if value else "{}"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(inline, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def short(ids: tuple[int, ...]) -> int | list[int]:
    """The `from` or `to` of a rule, as short as it can be."""
    return ids[0] if len(ids) == 1 else list(ids)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else inline(name)


def _seconds(time: int) -> float:
    """Such as come out as the same number of ns again."""
    return round(time * 1e-9, 9)


def _text(name: str, fault: Switch) -> str:
    return (
        ", ".join(f"{key} = {inline(value)}" for key, value in plain(name, fault).items()) or "on" if fault else "off"
    )


def _told(stretch: FaultPeriod) -> str:
    end = "" if stretch.end is None else f" to {stretch.end * 1e-9:.3f} s"
    return f"{_text(stretch.name, stretch.fault)} from {stretch.begin * 1e-9:.3f} s{end}"


def _in_file(spec: FleetSpec, sender: int, receiver: int, name: str, instant: int) -> str:
    """What the fleet file says of a fault at an instant."""
    for rule in reversed(spec.faults.rules):
        begin, end = window_of(rule)
        if name in rule.faults and rule.covers(sender, receiver) and begin <= instant < end:
            return _text(name, rule.faults[name])
    return "-"
