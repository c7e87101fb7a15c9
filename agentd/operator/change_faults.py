"""``agentd fault``: change the faults of a running fleet, show them, and export the changes."""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from agentd.daemon.operator_protocol import Answer, AppliedChange, Change, Clear, Show, changes_in, encode
from agentd.fault_rules import inline_toml, rules_to_toml, short_table
from agentd.operator.fault_history import FaultPeriod, fault_periods, fault_rules, overview
from agentd.operator.query import query_agents
from agentd.operator.running_fleet import RunningFleet, find_run
from agentd.operator.session import print_complaints
from dcf_zenoh.config import graph_of
from dcf_zenoh.configuration.checks.live_faults import check_change, check_ends, check_rules
from dcf_zenoh.configuration.reading.overrides import value_of
from dcf_zenoh.diagnostics import listed
from dcf_zenoh.errors import ConfigurationError, MessageError
from dcf_zenoh.spec import FaultRule, nanoseconds

READ_ONLY = ("show", "export")


def fault(name: str, senders: str | None, receivers: str | None, words: Sequence[str]) -> int:
    """Execute the command; return its exit code, 1 if an agent does not answer or refuses.

    Args:
        name: Run directory, or name of a fleet.
        senders: Ids of senders, with commas; None for all.
        receivers: Ids of receivers, with commas; None for all.
        words: ``clear``, ``show``, ``export``, or a fault and its values.

    Raises:
        ConfigurationError: The words are not valid, or not for this run.
        RecordingError: There is no such run.
        NetworkError: Zenoh cannot be opened.
    """
    what, *rest = words
    if rest and what in ("clear", *READ_ONLY):
        raise ConfigurationError(f"{what}: expected nothing more, not {' '.join(rest)!r}")
    folder = find_run(name)
    if folder != Path(name):
        _print_note(f"the run is {folder}")
    run = RunningFleet.read(folder)
    ends = _ids("--from", senders), _ids("--to", receivers)
    if what in READ_ONLY:
        return _show_or_export(run, check_ends(run.fleet, *ends), what)
    _check_changeable(run)
    if what == "clear":
        rule, text = check_ends(run.fleet, *ends), "as in the fleet file again"
        requests = {j: encode(Clear(senders=ids)) for j, ids in _senders_by_receiver(run, rule).items()}
    else:
        rule, notes = check_change(run.fleet, *ends, what, _fault_value(rest))
        for note in notes:
            _print_note(note)
        switch = rule.faults[what]
        text = f"{what} = {inline_toml(short_table(what, switch))}" if switch else f"{what} off"
        covered = _senders_by_receiver(run, rule)
        requests = {j: encode(Change(senders=ids, name=what, fault=switch)) for j, ids in covered.items()}
    answers, complaints = query_agents(run.address, requests)
    for j, answer in answers.items():
        print(f"{listed(answer.senders)} -> {j}: {text}, from {answer.time * 1e-9:.3f} s on")
    if complaints:
        complaints.append(
            f"what acts where, now or when a slow agent has caught up, tells agentd fault {run.folder} show"
        )
    return print_complaints(complaints)


def _show_or_export(run: RunningFleet, rule: FaultRule, what: str) -> int:
    """Print the faults and changes of the links that `rule` covers; return the exit code."""
    wanted = _senders_by_receiver(run, rule)
    times, changes, complaints = _history(run, wanted)
    periods = [
        each._replace(senders=senders)
        for j, done in changes.items()
        for each in fault_periods(j, done)
        if (senders := tuple(i for i in each.senders if i in wanted[j]))
    ]
    if what == "show":
        links = sorted((i, j) for j in times for i in wanted[j])
        print(f"{run.folder}{', which is over' if run.over else ''}, at {max(times.values(), default=0) * 1e-9:.3f} s")
        print(overview(run.fleet.spec, links, periods, times))
    elif periods or not complaints:  # without an agent's history "nothing was changed" may be wrong
        _export(run, periods)
    return print_complaints(complaints)


def _export(run: RunningFleet, periods: Iterable[FaultPeriod]) -> None:
    """Print the changes as rules for the end of the fleet file."""
    spec = run.fleet.spec
    rules = fault_rules(periods, spec.steps * spec.time.sample_time)
    print(rules_to_toml(rules) if rules else "# nothing was changed", end="" if rules else "\n")
    for line in check_rules(run.fleet, rules) if rules else ():
        _print_note(f"with these rules at the end of the fleet file: {line}")


def _history(
    run: RunningFleet, agents: Iterable[int]
) -> tuple[dict[int, int], dict[int, tuple[AppliedChange, ...]], list[str]]:
    """Collect the changes of faults from the agents, and from the logs of those that do not answer.

    Returns:
        Agent -> its fleet time in ns, agent -> changes on the links to it, and complaints about agents of which neither
        an answer nor a whole log could be read.
    """
    answers: dict[int, Answer] = {}
    complaints: list[str] = []
    if not run.over and run.fleet.spec.time.clock == "wall":
        answers, complaints = query_agents(run.address, {j: encode(Show()) for j in agents})
    times = {j: answer.time for j, answer in answers.items()}
    changes = {j: answer.changes for j, answer in answers.items()}
    for j in agents:
        if j in answers:
            continue
        if j not in run.logs:
            complaints.append(run.unreadable.get(j) or f"agent {j}: there is no log of it in {run.folder}")
            continue
        log = run.logs[j]
        if log.damage:
            complaints.append(f"{log.damage}; what was changed later is not known")
        try:
            changes[j] = changes_in(log)
        except MessageError as error:
            complaints.append(f"agent {j}: its log in {run.folder}: {error}")
            continue
        times[j] = max(0, log.end["time"] if log.end else 0, nanoseconds(log.acted[-1]) if len(log.acted) else 0)
    return times, changes, complaints


def _check_changeable(run: RunningFleet) -> None:
    """Raise an error if the faults of the run cannot be changed.

    Raises:
        ConfigurationError: The run is in virtual time, or over.
    """
    if run.fleet.spec.time.clock == "virtual":
        raise ConfigurationError(
            "a run in virtual time depends on its fleet file alone and cannot be changed from outside: put it into the"
            " fleet file, as a [[faults.rule]] with from, to and during",
            str(run.folder),
        )
    if run.over:
        raise ConfigurationError("this run is over; its log can still be looked at: show, export", str(run.folder))


def _senders_by_receiver(run: RunningFleet, rule: FaultRule) -> dict[int, tuple[int, ...]]:
    """Return receiver -> senders of the links that a rule covers."""
    graph = graph_of(run.fleet)
    covered = {j: tuple(i for i in graph.in_neighbours(j) if rule.covers(i, j)) for j in graph.agents}
    return {j: senders for j, senders in covered.items() if senders}


def _ids(option: str, text: str | None) -> tuple[int, ...] | None:
    if text is None:
        return None
    words = text.split(",")
    if not all(word.strip().isascii() and word.strip().isdecimal() for word in words):
        raise ConfigurationError(f"{option}: expected ids of agents with commas, such as 1 or 1,2, not {text!r}")
    return tuple(map(int, words))


def _fault_value(words: Sequence[str]) -> Any:
    """Parse the words after the name of a fault: a value, keys with values, or ``off`` (False)."""
    if list(words) == ["off"]:
        return False
    table: dict[str, Any] = {}
    for word in words:
        key, equals, text = word.partition("=")
        if not (equals and key.isidentifier()):
            key, text = "value", word
        if key in table:
            raise ConfigurationError(
                f"expected one value, or key=value for each key, such as mean=0.03 std=0.01; not {' '.join(words)!r}"
            )
        table[key] = value_of(text)
    return table["value"] if list(table) == ["value"] else table


def _print_note(text: str) -> None:
    print(f"agentd: note: {text}", file=sys.stderr)
