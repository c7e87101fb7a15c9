"""A whole fleet in one process and one thread, in virtual time."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from threadpoolctl import threadpool_limits

from dcf_zenoh.assembly import AgentParts, Blueprint
from dcf_zenoh.config import LoadedFleet, Overrides, freeze, load
from dcf_zenoh.errors import DcfError, NeighbourLost
from dcf_zenoh.graph import Graph
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import open_log
from dcf_zenoh.records.run import Run
from dcf_zenoh.requests import Activate, Agree, Publish, Report, Start, Wait
from dcf_zenoh.runner import Runner, quiet_arithmetic

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
    """Run a whole fleet in this process, in virtual time, regardless of the clock that its file names.

    Args:
        fleet: Fleet file, name of a built-in fleet, or loaded fleet.
        seed: Seed, in place of the file's.
        plant: Name or kind of the plant of every agent, in place of the file's.
        algorithm: Name or kind of the algorithm, in place of the file's.
        topology: Kind of the topology, in place of the file's.
        changes: Further changes, each like ``"exchange.max_rounds=40"``.
        out: Directory to record into; None keeps the run in memory.
        choose: Choice of the next agent among those that can continue; see `run_agents`.

    Returns:
        The run, as arrays.

    Raises:
        ConfigurationError: The fleet file, or a change, is not usable.
        DcfError: The error that stopped an agent.
    """
    if not isinstance(fleet, LoadedFleet):
        fleet = load(
            fleet,
            Overrides(seed=seed, plant=plant, algorithm=algorithm, topology=topology, clock="virtual"),
            changes=changes,
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


class _SimulatedAgent(Runner):
    """One agent of the simulation: the runner of its loop, which stops where a message is missing.

    Args:
        parts: The agent.
        ready: Agents that can continue; shared by all.

    Attributes:
        listeners: Its out-neighbours.
        now: Fleet time of this agent, ns.
        blocked_by: Neighbours whose messages it waits for; empty when it can continue.
    """

    def __init__(self, parts: AgentParts, ready: "list[_SimulatedAgent]") -> None:
        super().__init__()
        self.id = parts.id
        self.mailbox = parts.mailbox
        self.listeners: list[_SimulatedAgent] = []
        self.now = 0
        self.blocked_by: set[int] = set()
        self._loop = parts.loop
        self._ready = ready
        self._reply: int | None = None
        self._blocked_in: Wait | Activate | None = None

    def advance(self) -> bool:
        """Resume the loop until it has to wait for others; return whether it is still running."""
        try:
            while not self.blocked_by:
                self._reply = self.answer(self._loop.send(self._reply))  # type: ignore[arg-type]
        except StopIteration:
            return False
        return True

    def publish(self, request: Publish) -> int:
        """Put a message into the mailboxes of its receivers."""
        message, receiver = request
        for listener in self.listeners:
            if receiver is None or listener.id == receiver:
                listener.mailbox.put(message, message.sent)
                if message.sender in listener.blocked_by:
                    listener.unblock(message.sender)
        return self.now

    def wait(self, request: Wait) -> int:
        """Let time pass, or block until all senders' messages have been received."""
        if request.senders:
            self._block(request, request.senders)
        else:
            self.now = max(self.now, request.until)
        return self.now

    def activate(self, request: Activate) -> int:
        """Let time pass, and block until all senders have promised to send nothing before that instant."""
        self.now = max(self.now, request.until)
        self._block(request, request.senders)
        return self.now

    def start(self, request: Start) -> int:  # noqa: ARG002
        """Set fleet time to 0."""
        self.now = 0
        return 0

    def report(self, request: Report) -> int:  # noqa: ARG002
        """Ignore a phase of the flight: the log has it."""
        return self.now

    def agree(self, request: Agree) -> int:  # noqa: ARG002
        """Continue at once: simulated bodies need no consent."""
        return self.now

    def unblock(self, sender: int) -> None:
        """Become ready if `sender` was the last neighbour that this agent waits for."""
        assert self._blocked_in is not None
        if self._missing(self._blocked_in, (sender,)):
            return
        self.blocked_by.discard(sender)
        if not self.blocked_by:
            self._ready.append(self)

    @property
    def blocked(self) -> str:
        """Description of what the agent waits for; empty if it does not."""
        request = self._blocked_in
        if request is None or not self.blocked_by:
            return ""
        place = (
            f"at {request.until} ns"
            if isinstance(request, Activate)
            else f"in step {request.step} round {request.round}"
        )
        return f"agent {self.id} waits for {sorted(self.blocked_by)} {place}"

    def _block(self, request: Wait | Activate, senders: tuple[int, ...]) -> None:
        self._blocked_in = request
        self.blocked_by.update(self._missing(request, senders))

    def _missing(self, request: Wait | Activate, senders: tuple[int, ...]) -> tuple[int, ...]:
        """Return those of `senders` whose messages must still come before `request` is answered."""
        if isinstance(request, Activate):
            return self.mailbox.unpromised(senders, request.until)
        return self.mailbox.missing_from(senders, request.step, request.round)


def run_agents(parts: Sequence[AgentParts], graph: Graph, choose: Choice | None = None) -> None:
    """Run agents until all have ended.

    There is no event queue: every agent has its own time, and any agent that can continue may be next. The result
    does not depend on that choice.

    Args:
        parts: The agents.
        graph: Their links.
        choose: Number of agents that can continue -> index of the next one; None: the one that has waited longest.

    Raises:
        DcfError: The error that stopped an agent; or no agent can continue.
    """
    ready: list[_SimulatedAgent] = []
    agents = {part.id: _SimulatedAgent(part, ready) for part in parts}
    for i, agent in agents.items():
        agent.listeners = [agents[j] for j in graph.out_neighbours(i)]
    ready.extend(agents.values())
    running = len(ready)
    effect: NeighbourLost | None = None
    with quiet_arithmetic():
        while running:
            if not ready:
                raise effect or DcfError(f"the simulation is stuck: {_blocked(agents.values())}")
            agent = ready.pop(choose(len(ready)) if choose else 0)
            try:
                running -= not agent.advance()
            except NeighbourLost as error:  # the agent that is the cause raises its own error later
                effect = effect or error
                running -= 1
    if effect:
        raise effect


def _blocked(agents: Iterable[_SimulatedAgent]) -> str:
    return "; ".join(agent.blocked for agent in agents if agent.blocked_by)
