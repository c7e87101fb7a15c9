"""Changes of faults while a fleet runs: from when to when each one acts, as a table and as fault rules."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from agentd.daemon.operator_protocol import AppliedChange, Change, changes_in
from agentd.fault_rules import inline_toml, short_ids, short_table
from dcf_zenoh.configuration.building.fault_links import window_of
from dcf_zenoh.records.run import Run
from dcf_zenoh.spec import FaultRule, FleetSpec, Switch


class FaultPeriod(NamedTuple):
    """The time during which one change acts on links to one agent.

    Attributes:
        senders: Senders of the links.
        receiver: Receiver of the links.
        name: Name of the fault.
        fault: Table of the fault; False if the change switches the fault off.
        begin: Fleet time, ns.
        end: Fleet time, ns; None if the change has not been ended.
    """

    senders: tuple[int, ...]
    receiver: int
    name: str
    fault: Switch
    begin: int
    end: int | None

    def acts_on(self, sender: int, receiver: int) -> bool:
        """Return whether the change acts on the link ``sender -> receiver``."""
        return receiver == self.receiver and sender in self.senders


def fault_periods(receiver: int, changes: Sequence[AppliedChange]) -> list[FaultPeriod]:
    """Return when each change on links to an agent acts, in the order of the changes.

    A change of several links that ends at different times makes one period for each of these times.
    """
    acting: dict[tuple[int, str], int] = {}  # (sender, name) -> index of the change
    ends: dict[tuple[int, int], int | None] = {}  # (index of the change, sender) -> its end
    for index, (time, change) in enumerate((done.time, done.change) for done in changes):
        for j in change.senders:
            name = change.name if isinstance(change, Change) else None
            for key in [key for key in acting if key[0] == j and name in (None, key[1])]:
                ends[acting.pop(key), j] = time
            if name is not None:
                acting[j, name] = index
                ends[index, j] = None
    periods = []
    for index, done in enumerate(changes):
        if isinstance(change := done.change, Change):
            end_of = {j: ends[index, j] for j in change.senders}
            for end in dict.fromkeys(end_of.values()):
                senders = tuple(sorted(j for j in end_of if end_of[j] == end))
                periods.append(FaultPeriod(senders, receiver, change.name, change.fault, done.time, end))
    return periods


def fault_rules(periods: Iterable[FaultPeriod], length: float) -> list[dict[str, Any]]:
    """Return changes as rules for the end of a fleet file, sorted by begin and receiver.

    Args:
        periods: When the changes acted.
        length: Length of the run, s. What does not act within it is left out; what was not ended lasts until then.
    """
    rules = []
    for period in sorted(periods, key=lambda each: (each.begin, each.receiver)):
        begin, end = _seconds(period.begin), length if period.end is None else _seconds(period.end)
        if begin < min(end, length):
            links = {"from": short_ids(period.senders), "to": period.receiver, "during": [begin, end]}
            rules.append({**links, period.name: period.fault and short_table(period.name, period.fault)})
    return rules


def changes_of(run: Run) -> list[FaultRule]:
    """Return the changes in the logs of a run as rules, which take precedence over those of its fleet file.

    Raises:
        MessageError: A log holds a change that cannot be decoded.
    """
    periods = [each for j, log in run.agents.items() for each in fault_periods(j, changes_in(log))]
    return [
        FaultRule.model_validate(
            {name: {"kind": name, **each} if isinstance(each, dict) else each for name, each in rule.items()}
        )
        for rule in fault_rules(periods, run.fleet.steps * run.fleet.time.sample_time)
    ]


def overview(
    spec: FleetSpec, links: Iterable[tuple[int, int]], periods: Sequence[FaultPeriod], times: Mapping[int, int]
) -> str:
    """Return a table of faults: for each link what acts now, what the fleet file gives, and what was changed.

    Args:
        spec: Specification of the fleet.
        links: Links to show, as (sender, receiver).
        periods: When the changes acted.
        times: Receiver -> its present fleet time, ns.
    """
    rows = [("link", "fault", "acts now", "fleet file", "changed while running")]
    for i, j in links:
        in_file = {name for rule in spec.faults.rules if rule.covers(i, j) for name in rule.faults}
        changed = [each for each in periods if each.acts_on(i, j)]
        names = sorted(in_file | {each.name for each in changed})
        for name in names or ["-"]:
            changes = [each for each in changed if each.name == name]
            given = _in_file(spec, i, j, name, times[j])
            acting = next((_fault_text(name, each.fault) for each in changes if each.end is None), given)
            rows.append((f"{i} -> {j}", name, acting, given, "; ".join(map(_period_text, changes)) or "-"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def _seconds(time: int) -> float:
    """Convert ns to s, rounded such that the conversion back gives the same number of ns."""
    return round(time * 1e-9, 9)


def _fault_text(name: str, fault: Switch) -> str:
    if not fault:
        return "off"
    return ", ".join(f"{key} = {inline_toml(value)}" for key, value in short_table(name, fault).items()) or "on"


def _period_text(period: FaultPeriod) -> str:
    end = "" if period.end is None else f" to {period.end * 1e-9:.3f} s"
    return f"{_fault_text(period.name, period.fault)} from {period.begin * 1e-9:.3f} s{end}"


def _in_file(spec: FleetSpec, sender: int, receiver: int, name: str, instant: int) -> str:
    """Return what the fleet file says about a fault at an instant, "-" if nothing."""
    for rule in reversed(spec.faults.rules):
        begin, end = window_of(rule)
        if name in rule.faults and rule.covers(sender, receiver) and begin <= instant < end:
            return _fault_text(name, rule.faults[name])
    return "-"
