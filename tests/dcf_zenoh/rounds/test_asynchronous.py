"""Asynchronous virtual time against a naive simulation, event by event, that shares no code with it."""

import io
import math
import random
from heapq import heappop, heappush
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from dcf_zenoh.algorithms.algorithm import Dialogue
from dcf_zenoh.assembly import AgentParts
from dcf_zenoh.faults.chain import ALWAYS, FaultChain, Layer
from dcf_zenoh.faults.fault import FaultLink
from dcf_zenoh.faults.latency import Latency
from dcf_zenoh.graph import Graph, Neighbourhood, uniform
from dcf_zenoh.loop.agent import Ending
from dcf_zenoh.message import Last
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.plant import NoPlant
from dcf_zenoh.records.log_writer import Recorder
from dcf_zenoh.requests import Loop, Wait
from dcf_zenoh.rounds.activation import ActivationSchedule
from dcf_zenoh.rounds.asynchronous import Asynchronous
from dcf_zenoh.rounds.exchange import ComputeTime, Exchange, ExchangeOptions
from dcf_zenoh.rounds.receiver import Receiver
from dcf_zenoh.rounds.sender import Sender
from dcf_zenoh.simulation import run_agents
from dcf_zenoh.spec import Rounds

Trace = list[tuple[Any, ...]]
RECORDER = Recorder(io.BytesIO(), 0, {})


class Case(NamedTuple):
    """One small fleet. Times in ns; many of them coincide."""

    seed: int
    graph: Graph
    steps: int
    sample_time: int
    budget: int
    max_rounds: int
    period: dict[int, int]
    jitter: dict[int, int]
    compute: int
    latency: dict[tuple[int, int], int]
    quits: dict[int, int]  # agent -> activation at which its algorithm returns by itself

    @classmethod
    def draw(cls, seed: int) -> "Case":
        dice = random.Random(seed)
        agents = tuple(range(dice.randint(2, 5)))
        links = {(i, (i + 1) % len(agents)) for i in agents}
        links |= {(i, j) for i in agents for j in agents if i != j and dice.random() < 0.4}
        sample_time = dice.choice([20, 50, 100])
        period = {i: dice.choice([1, 2, 5, 7, 10, 30]) for i in agents}
        return cls(
            seed,
            Graph.of(agents, sorted(links)),
            steps=dice.randint(1, 4),
            sample_time=sample_time,
            budget=dice.choice([sample_time, sample_time // 2]),
            max_rounds=dice.choice([3, 1000]),
            period=period,
            jitter={i: dice.choice([0, 0, period[i] - 1]) for i in agents},
            compute=dice.choice([0, 0, 1, 4]),
            latency={link: dice.choice([0, 0, 1, 5, 33]) for link in links},
            quits={i: dice.choice([10**6, 2]) for i in agents},
        )


def dialogue(agent: int, step: int, quits: int, trace: Trace) -> Dialogue[int]:
    """Send agent, step and count; trace what is received, and how old it is."""
    count = 0
    while True:
        inbox = yield {"said": agent * 10**6 + step * 10**3 + count}, math.inf
        trace.append(
            (agent, step, count, inbox.stop, [(j, inbox[j]["said"], inbox.age(j), inbox.new(j)) for j in inbox])
        )
        count += 1
        if inbox.stop or count >= quits:
            return count


def simulated(case: Case, dice: random.Random) -> tuple[Trace, dict[int, int], Trace]:
    """Return what the agents receive in `run_agents`, sorted by agent; when each ended its last step; and what the
    links did in each step.
    """
    trace: Trace = []
    passed: Trace = []
    ends: dict[int, int] = {}

    def life(agent: int, exchange: Exchange) -> Loop[Ending]:
        for step in range(case.steps):
            due = step * case.sample_time
            now = yield Wait(due)
            running = dialogue(agent, step, case.quits[agent], trace)
            outcome = yield from exchange.negotiate(
                running, step, now, until=due + case.budget, next_step=due + case.sample_time
            )
            ends[agent] = outcome.now
            passed.append((agent, step, outcome.passed))
        now = yield Wait(case.steps * case.sample_time)
        yield exchange.goodbye(case.steps, now, Last.DONE)
        return Ending(Last.DONE)

    parts = []
    for agent in case.graph.agents:
        neighbourhood = Neighbourhood.of(case.graph, agent, uniform(case.graph))
        mailbox = Mailbox(neighbourhood.receives_from)
        links = {
            j: FaultChain(
                0, j, agent, [Layer("latency", [(ALWAYS, Latency(FaultLink(j, agent, Path()), mean=delay * 1e-9))])]
            )
            for j in neighbourhood.receives_from
            if (delay := case.latency[j, agent])
        }
        rng = np.random.Generator(np.random.Philox([case.seed, agent, 2]))
        settings = Rounds(mode="asynchronous", max_rounds=case.max_rounds)
        mode = Asynchronous(settings, ActivationSchedule(case.period[agent], case.jitter[agent], rng))
        options = ExchangeOptions(lambda: 0, compute_time=ComputeTime(case.compute))
        receiver = Receiver(mailbox, links, hold=True)
        exchange = Exchange(agent, neighbourhood, settings, mailbox, receiver, Sender(agent), mode, options)
        parts.append(AgentParts(agent, NoPlant(), mailbox, links, exchange, RECORDER, life(agent, exchange)))
    run_agents(parts, case.graph, dice.randrange)
    return sorted(trace), ends, sorted(passed)


class Naive:
    """Naive simulation by a queue of events in order of time: global knowledge, no messages, no promises."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.trace: Trace = []
        self.ends: dict[int, int] = {}
        self.events: list[tuple[int, int, str, tuple[Any, ...]]] = []
        self.said: dict[tuple[int, int], list[tuple[int, int, int]]] = {link: [] for link in case.latency}
        self.rng = {i: np.random.Generator(np.random.Philox([case.seed, i, 2])) for i in case.graph.agents}

    def at(self, time: int, what: str, *about: Any) -> None:
        heappush(self.events, (time, len(self.events) + random.randrange(10**9) * 10**3, what, about))

    def run(self) -> tuple[Trace, dict[int, int]]:
        for agent in self.case.graph.agents:
            self.at(0, "step", agent, 0)
        while self.events:
            time, _, what, about = heappop(self.events)
            getattr(self, what)(time, *about)
        return sorted(self.trace), self.ends

    def step(self, time: int, agent: int, step: int) -> None:
        self.at(time + self.case.compute, "publish", agent, step, 0, time, {})

    def publish(self, time: int, agent: int, step: int, count: int, activated: int, seen: dict[int, Any]) -> None:
        case = self.case
        for sender, receiver in case.latency:
            if sender == agent:
                said = agent * 10**6 + step * 10**3 + count
                self.said[sender, receiver].append((time + case.latency[sender, receiver], step, said))
        varied = case.period[agent]
        if case.jitter[agent]:
            varied += round(case.jitter[agent] * self.rng[agent].uniform(-1.0, 1.0))
        following = max(activated + max(1, varied), time + 1)
        until = step * case.sample_time + case.budget
        stop = following >= until or count + 1 >= case.max_rounds
        following = max(until, time + 1) if following >= until else following
        self.at(following, "activate", agent, step, count, stop, seen)

    def activate(self, time: int, agent: int, step: int, count: int, stop: bool, seen: dict[int, Any]) -> None:
        case, heard = self.case, []
        for sender in sorted(j for j, receiver in case.latency if receiver == agent):
            there = [said for due, k, said in self.said[sender, agent] if due < time and k == step]
            if there:
                newest = max(there)
                if seen.get(sender, (None, 0))[0] != newest:
                    seen[sender] = newest, count
                heard.append((sender, newest, count - seen[sender][1], seen[sender][1] == count))
        self.trace.append((agent, step, count, stop, heard))
        if not stop and count + 1 < case.quits[agent]:
            self.at(time + case.compute, "publish", agent, step, count + 1, time, seen)
            return
        self.ends[agent] = time + case.compute
        if step + 1 < case.steps:
            self.at(max(self.ends[agent], (step + 1) * case.sample_time), "step", agent, step + 1)


@pytest.mark.parametrize("block", range(10))
def test_a_thousand_small_fleets_do_what_a_naive_simulation_does(block: int) -> None:
    heard = 0
    for seed in range(100 * block, 100 * block + 100):
        case = Case.draw(seed)
        first, second = (simulated(case, random.Random(dice)) for dice in (seed, seed + 1000))
        assert first == second, case
        naive = Naive(case).run()
        assert first[:2] == naive, case
        heard += sum(len(entry[-1]) for entry in naive[0])
    assert heard > 1000  # there was something to compare
