"""Assembly of the parts of one agent from the specification of its fleet."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np

from dcf_zenoh.algorithms.algorithm import Me
from dcf_zenoh.config import LoadedFleet, graph_of, weights_of
from dcf_zenoh.configuration.building.fault_links import links_to, margin_of, needs_positions
from dcf_zenoh.configuration.building.problem_and_plant import plant_of, problem_of
from dcf_zenoh.controllers.controller import Controller
from dcf_zenoh.faults.chain import FaultChain
from dcf_zenoh.graph import Graph, Neighbourhood
from dcf_zenoh.loop.agent import Agent, AgentOptions, Ending
from dcf_zenoh.loop.agent_faults import NodeFaults
from dcf_zenoh.loop.phases import first_number
from dcf_zenoh.messaging.mailbox import Limits, Mailbox
from dcf_zenoh.plant import Array, Plant, State
from dcf_zenoh.plugins import bind, create, load
from dcf_zenoh.problems.geometry import SafetyRegion
from dcf_zenoh.records.log_writer import Recorder, StepRecord
from dcf_zenoh.requests import Loop
from dcf_zenoh.rounds.activation import ActivationSchedule
from dcf_zenoh.rounds.asynchronous import Asynchronous
from dcf_zenoh.rounds.exchange import ComputeTime, Exchange, ExchangeMode, ExchangeOptions
from dcf_zenoh.rounds.receiver import Receiver
from dcf_zenoh.rounds.sender import Sender
from dcf_zenoh.rounds.synchronous import Synchronous
from dcf_zenoh.spec import FleetSpec, Rounds, nanoseconds


class Restart(NamedTuple):
    """Restart of an agent while its fleet is running.

    Attributes:
        incarnation: Number of the incarnation that begins now; 1 after the first restart.
        state: Last state in the agent's log.
    """

    incarnation: int
    state: State


@dataclass(frozen=True)
class AgentParts:
    """Parts of one agent.

    Attributes:
        id: Id of the agent.
        plant: Its body; the owner calls `close` at the end.
        mailbox: Mailbox into which a runner puts received messages.
        links: Neighbour -> fault chain of the link from it; links without faults are left out.
        exchange: Its rounds; after a failure it makes the goodbye.
        recorder: Its log; after a failure it takes the reason.
        loop: Algorithm 1, not started.
    """

    id: int
    plant: Plant
    mailbox: Mailbox
    links: dict[int, FaultChain]
    exchange: Exchange
    recorder: Recorder
    loop: Loop[Ending]


@dataclass(frozen=True)
class Blueprint:
    """Everything that the agents of a fleet have in common, computed once."""

    fleet: LoadedFleet
    graph: Graph
    weights: Array

    @classmethod
    def of(cls, fleet: LoadedFleet) -> "Blueprint":
        """Build the graph of `fleet` and its weights."""
        graph = graph_of(fleet)
        return cls(fleet, graph, weights_of(fleet.spec, graph))

    def neighbourhood(self, agent: int) -> Neighbourhood:
        """Return the part of the graph around `agent`."""
        return Neighbourhood.of(self.graph, agent, self.weights)

    def build(
        self,
        agent: int,
        stream: BinaryIO,
        header: Mapping[str, Any],
        observe: Callable[[StepRecord], None] = lambda _record: None,
        restart: Restart | None = None,
    ) -> AgentParts:
        """Build the parts of one agent.

        Args:
            agent: Id of the agent.
            stream: Stream to which its log is written.
            header: Entries of the log's header in addition to those from the fleet file.
            observe: Called with every step's record once it is written.
            restart: Restart of the agent while its fleet is running; None: it starts with the fleet.

        Raises:
            PluginError: A constructor refused its options.
        """
        spec = self.fleet.spec
        neighbourhood, virtual = self.neighbourhood(agent), spec.time.clock == "virtual"
        me = Me(agent, spec.ids, neighbourhood, np.random.Generator(np.random.Philox([spec.seed, agent])))
        problem, plant = problem_of(spec, self.fleet.folder, agent), self.plant(agent)
        first = first_number(neighbourhood.diameter)
        limits = Limits(spec.steps, spec.exchange.max_rounds, nanoseconds(spec.time.sample_time))
        mailbox = Mailbox(neighbourhood.receives_from, first=None if restart else first, limits=limits)
        links = links_to(spec, self.fleet.folder, self.graph, agent)
        sender = Sender(agent, restart.incarnation, 0) if restart else Sender(agent, 0, first)
        node_faults = NodeFaults(
            spec.agents[agent].faults, (lambda now, until: sender.away(0, now, until)) if virtual else None
        )
        barrier = problem.separation if isinstance(problem, SafetyRegion) else None
        separation = spec.safety.separation
        checked = separation.then != "ignore" and (separation.min is not None or barrier is not None)
        positions = checked or needs_positions(spec, self.fleet.folder)
        exchange = self._exchange(me, mailbox, links, sender, node_faults.slowness, positions=positions)
        fleet_header = {"fleet": spec.name, "seed": spec.seed, "clock": spec.time.clock}
        recorder = Recorder(stream, agent, {**fleet_header, **header}, observe)
        options = AgentOptions(
            getattr(problem, "distance_to_go", lambda _state: 0.0),
            node_faults,
            barrier,
            restart.state if restart else None,
        )
        loop = Agent(spec, me, plant, self._renewal(me, problem), exchange, recorder, options).run()
        return AgentParts(agent, plant, mailbox, links, exchange, recorder, loop)

    def plant(self, agent: int) -> Plant:
        """Create the body of one agent.

        Raises:
            PluginError: Its constructor refused its options.
        """
        return plant_of(self.fleet.spec, self.fleet.folder, agent)

    def _renewal(self, me: Me, problem: object) -> Callable[[], Controller]:
        """Return a function that creates the controller of an agent, without memory of an earlier one."""
        spec, folder, control = self.fleet.spec, self.fleet.folder, self.fleet.spec.controller_kind
        algorithm = bind(load("algorithms", spec.algorithm.kind, folder), spec.algorithm.options, "algorithm")

        def renew() -> Controller:
            me.forget()
            context = {"problem": problem, "algorithm": algorithm, "me": me, "sample_time": spec.time.sample_time}
            kind = load("controllers", control.kind, folder)
            return cast(Controller, create(kind, context, control.options, "controller"))

        return renew

    def _exchange(
        self,
        me: Me,
        mailbox: Mailbox,
        links: Mapping[int, FaultChain],
        sender: Sender,
        slowness: Callable[[int], float] | None,
        *,
        positions: bool,
    ) -> Exchange:
        """Build the exchange of one agent."""
        spec, folder = self.fleet.spec, self.fleet.folder
        virtual = spec.time.clock == "virtual"
        rounds = spec.exchange.model_copy(update={"margin": margin_of(spec, folder)})
        receiver = Receiver(
            mailbox,
            links,
            hold=rounds.missing == "hold",
            skip_after_rounds=rounds.skip_after_rounds,
            log_all=not virtual,
        )
        options = ExchangeOptions(
            time.perf_counter_ns,
            me.take_notes if spec.log.rounds else None,
            ComputeTime(nanoseconds(rounds.compute_time) if virtual else 0, slowness, virtual),
            share_position=positions,
        )
        mode = _mode(spec, rounds, me.id)
        return Exchange(me.id, me.neighbourhood, rounds, mailbox, receiver, sender, mode, options)


def _mode(spec: FleetSpec, rounds: Rounds, agent: int) -> ExchangeMode:
    """Return the mode of the exchange; an asynchronous one with the agent's own random numbers."""
    if rounds.mode == "synchronous":
        return Synchronous(rounds)
    activation = spec.activation(agent)
    rng = np.random.Generator(np.random.Philox([spec.seed, agent, 2]))
    period, jitter = nanoseconds(activation.period or 0), nanoseconds(activation.jitter or 0)
    return Asynchronous(rounds, ActivationSchedule(period, jitter, rng))
