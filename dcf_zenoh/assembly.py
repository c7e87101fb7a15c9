"""From the specification of a fleet to the parts of one agent."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, cast

import numpy as np

from dcf_zenoh.agent import agent as agent_loop
from dcf_zenoh.algorithms.algorithm import Me
from dcf_zenoh.config import LoadedFleet, graph_of, weights_of
from dcf_zenoh.controllers.controller import Controller
from dcf_zenoh.exchange import Exchange
from dcf_zenoh.graph import Graph, Neighbourhood
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.messaging.message import Last
from dcf_zenoh.plant import Array, NoPlant, Plant, State, read_only
from dcf_zenoh.plugins import bind, create, load
from dcf_zenoh.recording import Recorder, StepRecord
from dcf_zenoh.requests import Loop


@dataclass(frozen=True)
class AgentParts:
    """One agent, put together.

    Attributes:
        id: Of the agent.
        plant: Its body; the owner calls `prepare` before the loop starts and `close` at the end.
        mailbox: Where a runner puts what arrives.
        exchange: Its rounds; after a failure it has the goodbye.
        recorder: Its log; after a failure it takes the reason.
        loop: Algorithm 1, not started.
    """

    id: int
    plant: Plant
    mailbox: Mailbox
    exchange: Exchange
    recorder: Recorder
    loop: Loop[Last]


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
    ) -> AgentParts:
        """Put one agent together.

        Args:
            agent: Its id.
            stream: Where its log goes.
            about: What the log's header says beside what the fleet file does.
            observe: Told of every step once it is recorded.

        Raises:
            PluginError: A constructor refused its options.
        """
        spec, folder = self.fleet.spec, self.fleet.folder
        own = spec.agent(agent)
        hood = self.hood(agent)
        me = Me(agent, spec.ids, hood, np.random.Generator(np.random.Philox([spec.seed, agent])))
        known: dict[str, Any] = {
            "agent": agent,
            "agents": spec.ids,
            "sample_time": spec.time.sample_time,
            "start": read_only(own.start),
            "rng": np.random.Generator(np.random.Philox([spec.seed, agent, 1])),
        }
        where = f"agents.{agent}"
        problem = create(load("problems", own.problem.kind, folder), known, own.problem.options, f"{where}: problem")
        algorithm = bind(load("algorithms", spec.algorithm.kind, folder), spec.algorithm.options, "algorithm")
        plant: Plant = NoPlant()
        if own.plant is not None:
            kind = load("plants", own.plant.kind, folder)
            plant = cast(Plant, create(kind, known, own.plant.options, f"{where}: plant"))
        control = spec.controller_kind
        controller = cast(
            Controller,
            create(
                load("controllers", control.kind, folder),
                {"problem": problem, "algorithm": algorithm, "me": me, "sample_time": spec.time.sample_time},
                control.options,
                "controller",
            ),
        )
        mailbox = Mailbox(hood.receives_from)
        noted = me.take_notes if spec.log.rounds else None
        rounds = spec.exchange
        if spec.time.clock == "wall":  # there computing takes the time it takes
            rounds = rounds.model_copy(update={"compute_time": 0.0})
        exchange = Exchange(agent, lambda _step: hood, rounds, mailbox, time.perf_counter_ns, noted=noted)
        header = {"fleet": spec.name, "seed": spec.seed, "clock": spec.time.clock, **about}
        recorder = Recorder(stream, agent, header, observe)
        distance: Callable[[State], float] = getattr(problem, "distance_to_go", lambda _state: 0.0)
        loop = agent_loop(spec, me, plant, controller, exchange, recorder, distance)
        return AgentParts(agent, plant, mailbox, exchange, recorder, loop)
