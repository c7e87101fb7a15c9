"""Findings on a run: what a person should know before trusting it, in one line each."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:  # a run has findings
    from dcf_zenoh.records.run import Run

LATE_SHARE = 0.01  # share of an agent's steps above which missed deadlines are a finding
PAIRS_MAX = 5  # pairs whose violations are described one by one
_MESSAGES = {  # counts of a log's end -> finding
    "refused": "refused {count} messages: not readable, or not plausible",
    "duplicates": "received {count} messages twice: is another daemon running as one of its neighbours?",
    "overtaken": "dropped {count} messages that came after they had been given up",
}


class Finding(NamedTuple):
    """Finding on a run.

    Attributes:
        kind: 'violation', 'incomplete', 'not arrived', 'deadlines', 'refused', 'duplicates' or 'overtaken'.
        text: Description, with agents, times and units.
    """

    kind: str
    text: str

    @property
    def severe(self) -> bool:
        """Whether bodies were closer than allowed."""
        return self.kind == "violation"


def findings_of(run: "Run") -> tuple[Finding, ...]:
    """Return the findings on a run, violations of safety regions first."""
    return (*_violations(run), *_incomplete(run), *_not_arrived(run), *_deadlines(run), *_messages(run))


def _violations(run: "Run") -> Iterator[Finding]:
    """Yield a finding for each pair, or agent and obstacle, that was too close."""
    pairs = list(dict.fromkeys((each.quantity, each.agents) for each in run.violations))
    for quantity, agents in pairs[:PAIRS_MAX]:
        own = [each for each in run.violations if (each.quantity, each.agents) == (quantity, agents)]
        if quantity == "barrier":
            what = f"agents {agents[0]} and {agents[1]} were in each other's safety region"
        else:
            what = f"agent {agents[0]} was in obstacle {agents[1] + 1}"
        times = "" if len(own) == 1 else f", {len(own)} times"
        total, least = sum(each.duration for each in own), min(each.value for each in own)
        yield Finding("violation", f"{what} from {own[0].since:.2f} s, for {total:.2f} s{times}; least h {least:.3f}")
    if more := len(pairs[PAIRS_MAX:]):
        yield Finding("violation", f"{more} more {'pair was' if more == 1 else 'pairs were'} too close")


def _incomplete(run: "Run") -> Iterator[Finding]:
    """Yield a finding for each agent of which not all is known: what it did then may have been anything."""
    yield from (Finding("incomplete", text) for text in run.gaps)
    for agent, log in run.agents.items():
        for number, (step, end) in enumerate(log.earlier, 1):
            if end is None:
                after = f"step {step}" if step >= 0 else "nothing"
                text = f"agent {agent}'s life {number} of {log.lives} broke off after {after}; it was started again"
                yield Finding("incomplete", text)


def _not_arrived(run: "Run") -> Iterator[Finding]:
    """Yield a finding for each agent that ended away from its target, if the fleet was to arrive."""
    rule = run.fleet.time.arrived
    if rule is None or run.arrival_time is not None or not run.positions.size:
        return
    away = []
    for column, agent in enumerate(run.agents):
        if (target := run.targets.get(agent)) is not None:
            gap = float(np.linalg.norm(run.positions[-1, column, : len(target)] - target))
            if not gap <= rule.within:
                away.append(f"agent {agent} is {gap:.2f} m from its target at the end")
    yield from (Finding("not arrived", text) for text in away)
    if not away and not run.gaps:
        text = f"the agents were not at their targets together for {rule.for_:g} s"
        yield Finding("not arrived", text)


def _deadlines(run: "Run") -> Iterator[Finding]:
    for agent, log in run.agents.items():
        late, steps = int(log.late.sum()), len(log.step)
        if late > LATE_SHARE * steps:
            yield Finding("deadlines", f"agent {agent} missed {late} of {steps} deadlines ({late / steps:.1%})")


def _messages(run: "Run") -> Iterator[Finding]:
    for kind, text in _MESSAGES.items():
        for agent, log in run.agents.items():
            if count := log.counts.get(kind, 0):
                yield Finding(kind, f"agent {agent} {text.format(count=count)}")
