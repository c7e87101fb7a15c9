"""From the specification of a fleet to the parts of one agent."""

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
from dcf_zenoh.loop.agent import Agent, Ending
from dcf_zenoh.loop.agent_faults import NodeFaults
from dcf_zenoh.loop.phases import first_number
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.plant import Array, Plant, State
from dcf_zenoh.plugins import bind, create, load
from dcf_zenoh.records.writer import Recorder, StepRecord
from dcf_zenoh.requests import Loop
from dcf_zenoh.rounds.activation import ActivationSchedule
from dcf_zenoh.rounds.exchange import Exchange
from dcf_zenoh.rounds.receiver import Receiver
from dcf_zenoh.rounds.sender import Sender
from dcf_zenoh.spec import FleetSpec, nanoseconds


class LastLife(NamedTuple):
    """What an agent left behind that is started again while its fleet is running.

    Attributes:
        incarnation: Which life begins now; 1 after the first restart.
        state: The last one in its log.
    """

    incarnation: int
    state: State


@dataclass(frozen=True)
class AgentParts:
    """One agent, put together.

    Attributes:
        id: Of the agent.
        plant: Its body; the owner calls `close` at the end.
        mailbox: Where a runner puts what arrives.
        links: Neighbour -> the faults of the link from it, of the links that have any.
        exchange: Its rounds; after a failure it has the goodbye.
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
    """What all agents of a fleet have in common, computed once."""

    fleet: LoadedFleet
    graph: Graph
    weights: Array

    @classmethod
    def of(cls, fleet: LoadedFleet) -> "Blueprint":
        """Draw the graph of `fleet`."""
        graph = graph_of(fleet)
        return cls(fleet, graph, weights_of(fleet.spec, graph))

    def hood(self, agent: int) -> Neighbourhood:
        """What `agent` knows of the graph."""
        return Neighbourhood.of(self.graph, agent, self.weights)

    def build(
        self,
        agent: int,
        stream: BinaryIO,
        about: Mapping[str, Any],
        observe: Callable[[StepRecord], None] = lambda _record: None,
        last_life: LastLife | None = None,
    ) -> AgentParts:
        """Put one agent together.

        Args:
            agent: Its id.
            stream: Where its log goes.
            about: What the log's header says beside what the fleet file does.
            observe: Told of every step once it is recorded.
            last_life: What is known of the agent if it was started again while the fleet was running.

        Raises:
            PluginError: A constructor refused its options.
        """
        spec, folder = self.fleet.spec, self.fleet.folder
        hood = self.hood(agent)
        me = Me(agent, spec.ids, hood, np.random.Generator(np.random.Philox([spec.seed, agent])))
        problem, plant = problem_of(spec, folder, agent), self.plant(agent)
        algorithm = bind(load("algorithms", spec.algorithm.kind, folder), spec.algorithm.options, "algorithm")
        control = spec.controller_kind

        def renew() -> Controller:
            me.forget()
            context = {"problem": problem, "algorithm": algorithm, "me": me, "sample_time": spec.time.sample_time}
            kind = load("controllers", control.kind, folder)
            return cast(Controller, create(kind, context, control.options, "controller"))

        virtual = spec.time.clock == "virtual"
        first = first_number(hood.diameter)
        mailbox = Mailbox(hood.receives_from, first=None if last_life else first)
        links = links_to(spec, folder, self.graph, agent)
        rounds = spec.exchange.model_copy(update={"margin": margin_of(spec, folder)})
        sender = Sender(agent, last_life.incarnation, 0) if last_life else Sender(agent, 0, first)
        receiver = Receiver(
            mailbox, links, hold=rounds.missing == "hold", skip_after_rounds=rounds.skip_after_rounds, watch=not virtual
        )
        fate = NodeFaults(
            spec.agents[agent].faults, (lambda now, until: exchange.away(0, now, until)) if virtual else None
        )
        exchange = Exchange(
            agent,
            lambda _step: hood,
            rounds,
            mailbox,
            receiver,
            sender,
            time.perf_counter_ns,
            noted=me.take_notes if spec.log.rounds else None,
            rhythm=_rhythm(spec, agent) if rounds.mode == "asynchronous" else None,
            slowness=fate.slowness,
            virtual=virtual,
            tells_position=spec.safety.separation is not None or needs_positions(spec, folder),
        )
        header = {"fleet": spec.name, "seed": spec.seed, "clock": spec.time.clock, **about}
        recorder = Recorder(stream, agent, header, observe)
        distance: Callable[[State], float] = getattr(problem, "distance_to_go", lambda _state: 0.0)
        life = Agent(spec, me, plant, renew, exchange, recorder, distance, fate, last_life.state if last_life else None)
        return AgentParts(agent, plant, mailbox, links, exchange, recorder, life.run())

    def plant(self, agent: int) -> Plant:
        """The body of one agent.

        Raises:
            PluginError: Its constructor refused its options.
        """
        return plant_of(self.fleet.spec, self.fleet.folder, agent)


def _rhythm(spec: FleetSpec, agent: int) -> ActivationSchedule:
    """When the agent activates, by random numbers of its own."""
    activation = spec.activation(agent)
    rng = np.random.Generator(np.random.Philox([spec.seed, agent, 2]))
    return ActivationSchedule(nanoseconds(activation.period or 0), nanoseconds(activation.jitter or 0), rng)
