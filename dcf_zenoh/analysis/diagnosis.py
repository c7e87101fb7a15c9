"""Diagnosis of a run in plain words: why steps ended as they did, and which setting would change it."""

from collections import Counter
from collections.abc import Iterator, Sequence
from math import floor, inf
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:  # a run has a diagnosis
    from dcf_zenoh.records.agent_log import AgentLog
    from dcf_zenoh.records.run import Run

SHARE = 0.01  # of the agent-steps: what happens less often is not worth a line
ROUNDS_SHARE = 0.1  # of the agent-steps: some steps out of rounds are usual where targets are far
HALF = 0.5  # of a step's time: what takes more is its cause
CUT_OFF = 1  # messages of a link that the end of a step by time cuts off
ABSENT_SHARE = 0.1  # of a step's messages of a link: what loses more is the cause
RECEIVED, MISSING, LATE = 0, 1, 2  # columns of `AgentLog.links`
Mask = npt.NDArray[np.bool_]


class Diagnosis(NamedTuple):
    """Cause of something in a run.

    Attributes:
        kind: 'states', 'time', 'rounds', 'lost agents' or 'sides'.
        text: What happened, how often, and why.
        remedy: What would change it; empty if nothing in the fleet file does.
    """

    kind: str
    text: str
    remedy: str


def diagnose(run: "Run") -> tuple[Diagnosis, ...]:
    """Return the causes of steps that ended otherwise than by agreement, the most frequent kind of a cause first."""
    return (*_states(run), *_time(run), *_rounds(run), *_lost_agents(run), *_sides(run))


def without_states(log: "AgentLog") -> Mask:
    """Return for each step whether the agent lacked states of others, so that it could not pose its problem."""
    return _noted(log, "unknown_agents")


def _noted(log: "AgentLog", note: str) -> Mask:
    return np.array([each.get(note, 0) > 0 for each in log.notes], dtype=np.bool_)


def _agent_steps(run: "Run") -> int:
    return sum(len(log.step) for log in run.agents.values())


def _states(run: "Run") -> Iterator[Diagnosis]:
    """Yield steps in which an agent lacked the states of others."""
    count, total = sum(int(without_states(log).sum()) for log in run.agents.values()), _agent_steps(run)
    if not count > SHARE * total:
        return
    text = f"states were missing in {count} of {total} agent-steps, which had no setpoint of their own"
    if run.fleet.controller_kind.options.get("sharing", "flood") == "flood":
        text += ": controller.sharing = 'flood' bears no loss"
        yield Diagnosis("states", text, "--set controller.sharing=piggyback")
    else:
        yield Diagnosis("states", f"{text}: an agent was never heard of", "")


def _time(run: "Run") -> Iterator[Diagnosis]:
    """Yield the causes of steps that ran out of time, the most frequent first."""
    late = {agent: np.flatnonzero(_out_of_time(run, log)) for agent, log in run.agents.items()}
    total = sum(map(len, late.values()))
    if not total > SHARE * _agent_steps(run):
        return
    causes: dict[str, Counter[str]] = {}
    worst = _worst_links(run)
    for agent, rows in late.items():
        for row in rows:
            kind, who = _cause(run, agent, int(row), worst)
            causes.setdefault(kind, Counter())[who] += 1
    for kind, blamed in sorted(causes.items(), key=lambda item: -item[1].total()):
        share = f"in {blamed.total()} of {total} agent-steps that were out of time"
        most, count = blamed.most_common(1)[0]
        named = f" (most often {most}: {count})" if len(blamed) > 1 else f" ({most})" if most else ""
        if kind == "computation":
            remedy = "a larger time.sample_time, fewer exchange.max_rounds or a cheaper algorithm"
            yield Diagnosis("time", f"computation took most of the step {share}{named}", remedy)
        elif kind == "link":
            waits = run.fleet.exchange.round_timeout is None
            remedy = "exchange.round_timeout, so that a round does not wait for what is lost"
            remedy = remedy if waits else "a shorter exchange.round_timeout"
            yield Diagnosis("time", f"messages were missing or late {share}{named}", remedy)
        else:
            text = f"rounds took {_figure(_round_ms(run))} ms each {share}, {_blame(run)}"
            yield Diagnosis("time", text, _more_time(run))


def _out_of_time(run: "Run", log: "AgentLog") -> Mask:
    """Return for each step whether it ran out of time; in asynchronous mode that is how steps end, unless they overrun.

    Steps without the states of others are left out.
    """
    by_time = np.array([each == "budget" for each in log.stopped_by], dtype=np.bool_)
    return (log.late | by_time if run.fleet.exchange.mode == "synchronous" else log.late) & ~without_states(log)


def _worst_links(run: "Run") -> list[tuple[int, str]]:
    """Return for each step the number of messages that were not in time on the worst link, and the link.

    The worst of the whole fleet counts: in synchronous mode all agents wait for the slowest.
    """
    worst, names = np.zeros(run.steps, dtype=int), np.zeros(run.steps, dtype=int)
    links = [(other, agent) for agent, log in run.agents.items() for other in log.links]
    for number, (other, agent) in enumerate(links):
        log = run.agents[agent]
        absent = np.maximum(log.links[other][:, MISSING], log.links[other][:, LATE])  # one message can be both
        worse = absent > worst[log.step]
        worst[log.step[worse]], names[log.step[worse]] = absent[worse], number
    return [(int(count), "from {} to {}".format(*links[name])) for count, name in zip(worst, names, strict=True)]


def _cause(run: "Run", agent: int, row: int, worst: Sequence[tuple[int, str]]) -> tuple[str, str]:
    """Return kind and name of the cause for which a step of an agent ran out of time."""
    log = run.agents[agent]
    step, spent = log.step[row], float(log.negotiation[row])
    if _computing(run, log, row) >= HALF * spent:
        return "computation", f"agent {agent}"
    for other in log.links:
        theirs = run.agents.get(other)
        place = -1 if theirs is None else int(np.searchsorted(theirs.step, step))
        took_part = theirs is not None and place < len(theirs.step) and theirs.step[place] == step
        if theirs is not None and took_part and _computing(run, theirs, place) >= HALF * spent:
            return "computation", f"agent {other}"
    absent, link = worst[step]
    if absent > CUT_OFF and absent > ABSENT_SHARE * log.rounds[row]:
        return "link", link
    return "rounds", ""


def _computing(run: "Run", log: "AgentLog", row: int) -> float:
    """Return how much fleet time the computation of a step took, s."""
    if run.fleet.time.clock == "wall":
        return float(log.compute[row])
    slow, instant = run.fleet.agents[log.agent].faults.slow, float(log.sensed[row])
    begin, end = (slow and slow.during) or (-inf, inf)
    factor = slow.factor if slow and begin <= instant < end else 1.0
    return float(log.rounds[row]) * run.fleet.exchange.compute_time * factor


def _round_ms(run: "Run") -> float:
    """Return the median time of a round, ms."""
    logs = run.agents.values()
    times = [log.negotiation[log.rounds > 0] / log.rounds[log.rounds > 0] for log in logs]
    return float(np.median(np.concatenate(times))) * 1e3 if times else 0.0


def _blame(run: "Run") -> str:
    if run.fleet.exchange.mode == "asynchronous":
        return "as exchange.period says"
    if run.fleet.time.clock == "virtual":
        return "by the latency of the links"
    return "with little computation: the machine or the network is slow"


def _affordable(run: "Run") -> float:
    """Return how many rounds fit into the budget of a step."""
    each = _round_ms(run) * 1e-3
    return floor(run.fleet.exchange.step_budget(run.fleet.time.sample_time) / each) if each else inf


def _more_time(run: "Run") -> str:
    if run.fleet.exchange.mode == "asynchronous":
        return "a shorter exchange.period"
    return "a larger time.sample_time" if run.fleet.has_plants else "a larger exchange.budget"


def _rounds(run: "Run") -> Iterator[Diagnosis]:
    """Yield steps that ended without agreement, with how far from agreement they were."""
    logs = [log for log in run.agents.values() if len(log.step)]
    out = [np.array([each == "rounds" for each in log.stopped_by]) for log in logs]
    count, total = sum(int(each.sum()) for each in out), _agent_steps(run)
    if not count > ROUNDS_SHARE * total:
        return
    exchange = run.fleet.exchange
    residuals = np.concatenate([log.residual[rows] for log, rows in zip(logs, out, strict=True)])
    links = [counts[rows] for log, rows in zip(logs, out, strict=True) for counts in log.links.values()]
    received, missing = (float(sum(each[:, column].sum() for each in links)) for column in (RECEIVED, MISSING))
    text = (
        f"{count} of {total} agent-steps ended after exchange.max_rounds = {exchange.max_rounds} rounds without"
        f" agreement, with a residual of {_figure(np.median(residuals))} (median) and at most"
        f" {_figure(residuals.max())}; wanted is less than {_figure(exchange.threshold)}"
    )
    if missing > SHARE * (received + missing):
        text += f"; {missing / (received + missing):.0%} of the awaited messages were missing"
    rounds = min(_affordable(run), 10 * exchange.max_rounds)
    more = f"--set exchange.max_rounds={rounds:.0f}"
    yield Diagnosis("rounds", text, more if rounds > exchange.max_rounds else _more_time(run))


def _lost_agents(run: "Run") -> Iterator[Diagnosis]:
    """Yield steps in which an agent was left out because its state was old."""
    count, total = sum(int(_noted(log, "lost_agents").sum()) for log in run.agents.values()), _agent_steps(run)
    if count > SHARE * total:
        text = f"an agent counted as lost in {count} of {total} agent-steps: its last state was older than"
        yield Diagnosis("lost agents", f"{text} controller.lost_after", "a larger controller.lost_after")


def _sides(run: "Run") -> Iterator[Diagnosis]:
    """Yield steps in which the two agents of a pair chose sides differently."""
    count, total = sum(int(_noted(log, "sign_disagreements").sum()) for log in run.agents.values()), _agent_steps(run)
    if count > SHARE * total:
        text = f"the two agents of a pair used different signs in {count} of {total} agent-steps: states came too late"
        yield Diagnosis("sides", text, "more exchange.max_rounds or a shorter exchange.round_timeout")


def _figure(value: Any) -> str:
    """Return a number in two digits."""
    return f"{float(value):.2g}"
