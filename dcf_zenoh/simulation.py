"""A whole fleet in one process and one thread, in virtual time."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from threadpoolctl import threadpool_limits

from dcf_zenoh.assembly import AgentParts, Blueprint
from dcf_zenoh.config import LoadedFleet, freeze, load
from dcf_zenoh.errors import DcfError, NeighbourLost
from dcf_zenoh.graph import Graph
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.run import Run
from dcf_zenoh.records.writer import open_log
from dcf_zenoh.requests import Activate, Publish, Start, Wait

Choice = Callable[[int], int]


def simulate(
    fleet: str | Path | LoadedFleet,
    *,
    seed: int | None = None,
    plant: str | None = None,
    algorithm: str | None = None,
    topology: str | None = None,
    changes: Sequence[str] = (),
    out: str | Path | None = None,
    choose: Choice | None = None,
) -> Run:
    """Run a whole fleet in this process, in virtual time, whatever clock its file names.

    Args:
        fleet: A fleet file, the name of a built-in fleet, or one that is loaded already.
        seed: Instead of the file's.
        plant: Name or kind of the plant of every agent, instead of the file's.
        algorithm: Name or kind of the algorithm, instead of the file's.
        topology: Kind of the topology, instead of the file's.
        changes: Further changes, each like ``"exchange.max_rounds=40"``.
        out: Directory to record into; None keeps the run in memory.
        choose: Which of the agents that can go on does; see `run_agents`.

    Returns:
        The run, as arrays.

    Raises:
        ConfigurationError: The fleet file, or a change, is not usable.
        DcfError: Whatever stopped an agent.
    """
    if not isinstance(fleet, LoadedFleet):
        fleet = load(
            fleet, seed=seed, plant=plant, algorithm=algorithm, topology=topology, clock="virtual", changes=changes
        )
    if out is not None:
        out = Path(out)
        fleet = freeze(fleet, out)
    blueprint = Blueprint.of(fleet)
    name = fleet.spec.name if out is None else out.resolve().name
    streams: dict[int, BinaryIO] = {}
    with ExitStack() as stack:
        stack.enter_context(threadpool_limits(1))
        for agent in fleet.spec.ids:
            streams[agent] = BytesIO() if out is None else stack.enter_context(open_log(out, agent))
        parts = [blueprint.build(agent, stream, {"run": name}) for agent, stream in streams.items()]
        for part in parts:
            stack.callback(part.plant.close)
        run_agents(parts, blueprint.graph, choose)
    if out is not None:
        return Run.read(out)
    memory = {agent: stream.getvalue() for agent, stream in streams.items() if isinstance(stream, BytesIO)}
    logs = {agent: AgentLog.read(data, f"agent {agent}") for agent, data in memory.items()}
    return Run(name, fleet.spec, logs, home=fleet.folder)


class _Actor:
    """One agent as the simulator sees it."""

    __slots__ = ("blocked_by", "loop", "mailbox", "now", "parts", "reply", "wait")

    def __init__(self, parts: AgentParts) -> None:
        self.parts = parts
        self.mailbox = parts.mailbox
        self.loop = parts.loop
        self.now = 0
        self.reply: int | None = None
        self.wait: Wait | Activate | None = None  # what it waits for; None when it can go on
        self.blocked_by: set[int] = set()

    def heard(self, sender: int, ready: list["_Actor"]) -> None:
        """Go on if `sender` was the last one it waited for."""
        if self.wait is None or sender not in self.blocked_by or self.lacking(self.wait, (sender,)):
            return
        self.blocked_by.discard(sender)
        if not self.blocked_by:
            self.wait = None
            ready.append(self)

    def lacking(self, wait: Wait | Activate, senders: tuple[int, ...]) -> tuple[int, ...]:
        """Those of `senders` from whom more has to be known before `wait` ends."""
        if isinstance(wait, Activate):
            return self.mailbox.unpromised(senders, wait.until)
        return self.mailbox.lacks(senders, wait.step, wait.round)


def run_agents(parts: Sequence[AgentParts], graph: Graph, choose: Choice | None = None) -> None:
    """Step agents until all have returned.

    There is no event queue: time is the agents' own, and whichever agent can go on may go next. The result does
    not depend on that choice.

    Args:
        parts: The agents.
        graph: Who hears whom.
        choose: Number of agents that can go on -> index of the one that does; None: the one that waited longest.

    Raises:
        DcfError: Whatever stops an agent; or no agent can go on.
    """
    actors = {part.id: _Actor(part) for part in parts}
    listeners = {i: [actors[j] for j in graph.out_neighbours(i)] for i in graph.agents}
    ready = list(actors.values())
    running = len(ready)
    effect: NeighbourLost | None = None
    with np.errstate(over="ignore", invalid="ignore"):  # what is no number is refused in words, see `Talk`
        while running:
            if not ready:
                waiting = "; ".join(_plight(actor) for actor in actors.values() if actor.wait)
                raise effect or DcfError(f"the simulation is stuck: {waiting}")
            actor = ready.pop(choose(len(ready)) if choose else 0)
            try:
                running -= not _advance(actor, listeners[actor.parts.id], ready)
            except NeighbourLost as error:  # another one cannot go on; it is about to say why
                effect = effect or error
                running -= 1
    if effect:
        raise effect


def _advance(actor: _Actor, listeners: list[_Actor], ready: list[_Actor]) -> bool:
    """Resume `actor` until it waits for others; whether it is still running."""
    while True:
        try:
            request = actor.loop.send(actor.reply)  # type: ignore[arg-type]
        except StopIteration:
            return False
        if isinstance(request, Publish):
            message = request.message
            for listener in listeners:
                if request.receiver is not None and listener.parts.id != request.receiver:
                    continue
                listener.mailbox.put(message, message.sent)
                listener.heard(message.sender, ready)
        elif isinstance(request, Start):
            actor.now = 0
        elif isinstance(request, (Wait, Activate)):
            if isinstance(request, Activate) or not request.senders:
                actor.now = max(actor.now, request.until)
            actor.blocked_by = set(actor.lacking(request, request.senders))
            if actor.blocked_by:
                actor.wait = request
                actor.reply = actor.now
                return True
        actor.reply = actor.now


def _plight(actor: _Actor) -> str:
    wait = actor.wait
    assert wait is not None
    place = f"at {wait.until} ns" if isinstance(wait, Activate) else f"in step {wait.step} round {wait.round}"
    return f"agent {actor.parts.id} waits for {sorted(actor.blocked_by)} {place}"
