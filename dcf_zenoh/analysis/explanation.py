"""Explanation of the closest approach of two agents: disturbances of links before it, and a replay without them."""

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from dcf_zenoh.analysis.link_health import NETWORK, LinkHealth, link_health
from dcf_zenoh.analysis.replay import Replay, replay
from dcf_zenoh.config import LoadedFleet, graph_of
from dcf_zenoh.configuration.building.fault_links import window_of
from dcf_zenoh.errors import PluginError, RecordingError
from dcf_zenoh.faults.fault import Stage
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.plugins import load
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.run import ClosestApproach, Run
from dcf_zenoh.spec import FaultRule, Switch, nanoseconds

WINDOW = 2  # steps before the closest approach that are examined
_FURTHER = (4, 8)  # steps before it from which a replay begins, if later replays violate the barrier too


@dataclass(frozen=True)
class LinkStep:
    """Messages of one link in one step.

    Attributes:
        sender: Id of the sender.
        receiver: Id of the receiver.
        sent: Number of messages.
        lost: Cause of a loss -> rounds in which the lost messages were sent.
        late: Messages received after the end of their round, or after a newer one.
        missing: Rounds that the receiver ended without the message of the round.
        latency: Mean latency of the messages received, s; None where it is not known.
    """

    sender: int
    receiver: int
    sent: int
    lost: Mapping[str, tuple[int, ...]]
    late: int
    missing: int
    latency: float | None

    @property
    def lost_count(self) -> int:
        """Number of messages lost, by any cause."""
        return sum(map(len, self.lost.values()))

    @property
    def disturbed(self) -> bool:
        """Whether a message was lost, late or missing."""
        return bool(self.lost_count or self.late or self.missing)


@dataclass(frozen=True)
class AgentStep:
    """End of one step of one agent.

    Attributes:
        agent: Id of the agent.
        stopped_by: Reason for the end of its rounds in its log; empty if it has no record of the step.
        rounds: Number of rounds.
        residual: Residual of the agent at the stop.
        acted_after: Time from the measurement until its setpoint acted, s.
        overran: Whether the step was late: then `exchange.late` decided the setpoint, not the decision.
        notes: Counts of its controller that are not 0.
        remark: Remark in its log.
    """

    agent: int
    stopped_by: str
    rounds: int
    residual: float
    acted_after: float
    overran: bool
    notes: Mapping[str, float]
    remark: str

    @property
    def absent(self) -> bool:
        """Whether the agent took no part."""
        return self.stopped_by in ("", "abstained")


@dataclass(frozen=True)
class StepBefore:
    """One of the steps before the closest approach.

    Attributes:
        step: Control step k.
        value: Barrier or distance of the pair at the beginning of the step.
        between: Links of the shortest paths from one of the pair to the other and back.
        others: All other links to the two agents.
        elsewhere: All links to other agents that are not on those paths.
        agents: The two agents.
        absent: Agents of the fleet that took no part.
    """

    step: int
    value: float
    between: tuple[LinkStep, ...]
    others: tuple[LinkStep, ...]
    elsewhere: tuple[LinkStep, ...]
    agents: tuple[AgentStep, ...]
    absent: tuple[AgentStep, ...]

    @property
    def disturbed(self) -> bool:
        """Whether in the fleet an agent was absent, or a message lost, late or missing."""
        return bool(self.absent) or any(link.disturbed for link in self.links)

    @property
    def links(self) -> tuple[LinkStep, ...]:
        """All links of the fleet."""
        return self.between + self.others + self.elsewhere


@dataclass(frozen=True)
class Alternative:
    """Result of a replay.

    Attributes:
        replay: The replay.
        value: Barrier or distance of the pair at the step of the closest approach.
    """

    replay: Replay
    value: float


@dataclass(frozen=True)
class Explanation:
    """Explanation of the closest approach of two agents.

    Attributes:
        quantity: 'barrier', or 'distance' (m) where the problem has no safety region.
        closest: The closest approach, between the samples too if the paths of the bodies are known.
        step: Control step at whose begin the two were closest: replays are compared with this sample.
        pair: The two agents.
        value: Barrier or distance of the pair in that step.
        path: Shortest paths between the two agents, there and back; of two agents each if they are neighbours.
        before: The steps before it, the latest first; none if the closest approach is the start of the run.
        falsified: Fault that may have changed payloads in those steps -> number of links.
        alternatives: Replays without faults, from the step before on, then from earlier ones; none as for `before`.
    """

    quantity: str
    closest: ClosestApproach
    step: int
    pair: tuple[int, int]
    value: float
    path: tuple[tuple[int, ...], tuple[int, ...]]
    before: tuple[StepBefore, ...]
    falsified: Mapping[str, int]
    alternatives: tuple[Alternative, ...]

    @property
    def disturbed(self) -> bool:
        """Whether in the steps before a message was lost, late, missing or falsified, or an agent absent."""
        return bool(self.falsified) or any(each.disturbed for each in self.before)

    @property
    def took_time(self) -> bool:
        """Whether messages had a latency."""
        return any(link.latency for each in self.before for link in each.links)


def explain(run: Run, changes: Iterable[FaultRule] = ()) -> Explanation:
    """Find the closest approach of `run`, examine the links before it, and replay the steps before it without faults.

    The state at step k follows from the setpoints of step k - 1 and before. So these steps are examined and replayed
    without faults: step k - 1 alone, and all from k - 2 on. If the agents are in each other's safety regions even then,
    the replay begins earlier.

    Args:
        run: The run; it may still be going on.
        changes: Fault rules of operators during the run, in order; they override those of its fleet file.

    Raises:
        RecordingError: Nothing moves in the run, it has fewer than two agents, or no recorded step.
        DcfError: The replay fails.
    """
    values = _values(run)
    closest = run.closest()
    assert closest is not None  # there are values
    pair = (closest.agents[0], closest.agents[1])
    place = list(combinations(run.agents, 2)).index(pair)
    step = int(np.nanargmin(values[:, place]))
    graph = graph_of(LoadedFleet(run.fleet, run.home, run.name))
    path = _path(graph, *pair), _path(graph, *reversed(pair))
    health = link_health(run)
    ways = {hop for way in path for hop in pairwise(way)}
    before = tuple(
        _step_before(run, health, each, pair, ways, float(values[each, place]))
        for each in range(step - 1, max(-1, step - 1 - WINDOW), -1)
    )
    found = Explanation(
        quantity=closest.quantity,
        closest=closest,
        step=step,
        pair=pair,
        value=float(values[step, place]),
        path=path,
        before=before,
        falsified=_falsified(run, graph, [*run.fleet.faults.rules, *changes], [each.step for each in before]),
        alternatives=(),
    )
    alternatives: list[Alternative] = []
    for back in (*range(1, WINDOW + 1), *_FURTHER):
        if back > step or (back > WINDOW and (found.quantity == "distance" or alternatives[-1].value >= 0)):
            break
        again = replay(run, step - back, step)
        alternatives.append(Alternative(again, _value(run, again, pair)))
    return replace(found, alternatives=tuple(alternatives))


def _falsified(run: Run, graph: Graph, rules: Sequence[FaultRule], steps: Iterable[int]) -> dict[str, int]:
    """Return fault that may change payloads -> number of links on which it acts at some time in the steps."""
    length = nanoseconds(run.fleet.time.sample_time)
    begins = [window_of(rule)[0] for rule in rules]
    instants = [
        instant
        for begin in (step * length for step in steps)
        for instant in {begin, *(each for each in begins if begin < each < begin + length)}  # where the rules change
    ]
    found: Counter[str] = Counter()
    for receiver in graph.agents:
        for sender in graph.in_neighbours(receiver):
            own = [(rule.faults, *window_of(rule)) for rule in rules if rule.covers(sender, receiver)]
            names = set()
            for instant in instants:
                acting: dict[str, Switch] = {}
                for faults, begin, end in own:
                    if begin <= instant < end:
                        acting.update(faults)
                names |= {name for name, fault in acting.items() if fault and _falsifies(fault.kind, run.home)}
            found.update(names)
    return dict(sorted(found.items()))


def _falsifies(kind: str, folder: Path) -> bool:
    """Return whether a fault acts on payloads; False if its plug-in is not there any more."""
    try:
        stage = getattr(load("faults", kind, folder), "STAGE", None)
    except PluginError:
        return False
    return stage in (Stage.SENDER, Stage.PAYLOAD)


def _values(run: Run) -> Array:
    """Return the barrier or distance of every pair at every step, shape (K, pairs)."""
    if not run.steps:
        raise RecordingError(f"{run.name}: there is nothing to explain: no agent has recorded a step")
    if len(run.agents) < 2:
        raise RecordingError(f"{run.name}: there is nothing to explain: no two agents have a log")
    values = run.barriers if run.barriers.size else run.distances
    if not values.size:
        raise RecordingError(f"{run.name}: there is nothing to explain: nothing moves, as no agent has a plant")
    return values


def _value(run: Run, again: Replay, pair: tuple[int, int]) -> float:
    """Return the barrier or distance of the pair at the end of a replay."""
    d = run.positions.shape[2]
    i, j = (again.states[agent][: len(again.states[agent]) // 2][:d] for agent in pair)
    if not run.barriers.size:
        return float(np.linalg.norm(i - j))
    value = run.geometry.separation(pair, i, j)
    if value is None:
        raise RecordingError(f"{run.name}: {run.geometry.unknown}")
    return float(value)


def _path(graph: Graph, source: int, target: int) -> tuple[int, ...]:
    """Return a shortest path; of several, the one through the lowest ids."""
    previous: dict[int, int] = {source: source}
    queue = deque([source])
    while target not in previous:
        here = queue.popleft()
        for there in graph.out_neighbours(here):
            if there not in previous:
                previous[there] = here
                queue.append(there)
    way = [target]
    while way[-1] != source:
        way.append(previous[way[-1]])
    return tuple(reversed(way))


def _step_before(
    run: Run,
    health: Iterable[LinkHealth],
    step: int,
    pair: tuple[int, int],
    ways: set[tuple[int, int]],
    value: float,
) -> StepBefore:
    links = [_link_step(run.agents[each.receiver], each, step) for each in health]
    between = [link for link in links if (link.sender, link.receiver) in ways]
    others = [link for link in links if link.receiver in pair and link not in between]
    agents = {i: _agent_step(log, step) for i, log in run.agents.items()}
    return StepBefore(
        step=step,
        value=value,
        between=tuple(between),
        others=tuple(others),
        elsewhere=tuple(link for link in links if link not in between and link not in others),
        agents=tuple(agents[i] for i in pair),
        absent=tuple(each for each in agents.values() if each.absent),
    )


def _link_step(log: AgentLog, health: LinkHealth, step: int) -> LinkStep:
    lost: dict[str, list[int]] = {}
    crossings = [each for each in health.crossings if each.step == step]
    for each in (each for each in crossings if each.lost_by):
        lost.setdefault(each.lost_by, []).append(each.round)
    latencies = [each.latency for each in crossings if each.latency is not None]
    rows = np.flatnonzero(log.step == step)
    sent, _, late = health.per_step[step] if step < len(health.per_step) else (0, 0, 0)
    missing = log.links[health.sender][rows, 1].sum()
    by = {cause: tuple(rounds) for cause, rounds in sorted(lost.items(), key=lambda entry: entry[0] == NETWORK)}
    latency = float(np.mean(latencies)) if latencies else None
    return LinkStep(health.sender, health.receiver, int(sent), by, int(late), int(missing), latency)


def _agent_step(log: AgentLog, step: int) -> AgentStep:
    rows = np.flatnonzero(log.step == step)
    if not len(rows):
        return AgentStep(log.agent, "", 0, float("inf"), 0.0, False, {}, "")
    row = int(rows[-1])
    return AgentStep(
        agent=log.agent,
        stopped_by=log.stopped_by[row],
        rounds=int(log.rounds[row]),
        residual=float(log.residual[row]),
        acted_after=float(log.negotiation[row]),
        overran=bool(log.late[row]),
        notes={name: count for name, count in log.notes[row].items() if count},
        remark=log.remarks[row],
    )
