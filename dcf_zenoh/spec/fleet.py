"""The specification of a fleet with all its tables."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from dcf_zenoh.spec.faults import AgentFaults, Faults
from dcf_zenoh.spec.safety import Arena, Safety
from dcf_zenoh.spec.table import AgentId, Kind, Name, NonNegativeFloat, PositiveFloat, Table, Vector


class Topology(Kind):
    """Graph of the links, and mixing weights."""

    kind: str = "complete"
    weights: Literal["auto", "metropolis", "laplacian", "uniform", "uneven"] = Field(
        default="auto", description="mixing weights; auto: metropolis on undirected graphs, uniform on directed ones"
    )
    weight_step: PositiveFloat | None = Field(
        default=None, description="laplacian: weight of each neighbour; none: 1 / (1 + most neighbours)"
    )


class Arrived(Table):
    """Condition for an agent to count as arrived: how near its target, and for how long."""

    within: PositiveFloat = Field(default=0.05, description="m")
    for_: NonNegativeFloat = Field(default=1.0, alias="for", description="s")


class Time(Table):
    """Clock, control period and length of a run."""

    clock: Literal["wall", "virtual"] = Field(
        default="virtual", description="real time, or time computed by the model alone"
    )
    sample_time: PositiveFloat = Field(default=0.2, description="control period t_s, s")
    duration: PositiveFloat = Field(default=25.0, description="length of the run, s")
    arrived: Arrived | None = Field(default=None, description="end the run early, when all agents have arrived")

    @property
    def steps(self) -> int:
        """Number of control steps in `duration`."""
        return max(1, round(self.duration / self.sample_time))


class Rounds(Table):
    """Rounds of a control step: number, time, when they end, and what stands in for missing values."""

    mode: Literal["synchronous", "asynchronous"] = Field(
        default="synchronous",
        description="rounds in step with the neighbours, or activations at each agent's own instants",
    )
    period: PositiveFloat | None = Field(
        default=None, description="asynchronous: s between an agent's activations; none: budget / max_rounds"
    )
    jitter: NonNegativeFloat = Field(
        default=0.0, description="asynchronous: s by which the time between two activations varies, either way"
    )
    budget: PositiveFloat | None = Field(
        default=None, description="s of each step for rounds; none: 3/4 of sample_time"
    )
    max_rounds: Annotated[int, Field(ge=1)] = Field(
        default=200, description="most rounds of a step, those for sharing states included"
    )
    threshold: NonNegativeFloat = Field(
        default=1e-3, description="the step ends when every agent's residual is below this"
    )
    round_timeout: PositiveFloat | None = Field(
        default=None, description="longest wait for a round's messages, s; none: the budget"
    )
    missing: Literal["hold", "absent"] = Field(
        default="hold", description="what an algorithm sees of a neighbour not heard in time"
    )
    late: Literal["previous_plan", "hold", "land"] = Field(
        default="previous_plan", description="what flies when a step overruns"
    )
    compute_time: NonNegativeFloat = Field(
        default=0.0, description="s that a round's computation takes; virtual clock only"
    )
    margin: Annotated[int, Field(ge=0)] | None = Field(
        default=None,
        description="rounds between announcing the end and leaving; none: 3 if messages can be lost or late, else 0",
    )
    skip_after_rounds: Annotated[int, Field(ge=1)] = Field(
        default=20,
        description="rounds without a neighbour's message after which it is not waited for until heard again",
    )

    def step_budget(self, sample_time: float) -> float:
        """Return the time of each control step that rounds may take, s."""
        return 0.75 * sample_time if self.budget is None else self.budget


class Log(Table):
    """Records in addition to one per step."""

    rounds: bool = Field(default=False, description="record payload, residual and reception times of every round")


class NetworkTable(Table):
    """Zenoh: endpoints of agents, time-outs, and settings of Zenoh itself."""

    base_port: Annotated[int, Field(ge=1024, le=65000)] = Field(
        default=7450,
        description="agent i listens on tcp/127.0.0.1:(base_port + i) unless it or the launcher says otherwise",
    )
    ready_timeout: PositiveFloat = Field(
        default=30.0, description="longest wait for the neighbours before the start, s"
    )
    receive_timeout: PositiveFloat = Field(
        default=10.0, description="virtual clock: real s without an awaited message that are an error"
    )
    settings: dict[str, Any] = Field(
        default_factory=dict,
        description="Zenoh configuration keys as paths ('transport/link/tx/lease') with their values",
    )


class Activation(Table):
    """Period and jitter of an agent's activations in asynchronous mode."""

    period: PositiveFloat | None = Field(default=None, description="s; none: the fleet's")
    jitter: NonNegativeFloat | None = Field(default=None, description="s; none: the fleet's")


class AgentTable(Table):
    """One agent, and the keys in which it differs from the fleet."""

    start: Vector | None = Field(default=None, description="position before the first step, m")
    target: Vector | None = Field(default=None, description="short for problem.target, m")
    plant: str | None = Field(default=None, description="name of its plant; none: the fleet's")
    endpoint: Annotated[str, Field(pattern=r"^[a-z0-9-]+/[^ ]+$")] | None = Field(
        default=None, description="where it listens, such as 'tcp/192.168.1.11:7447'"
    )
    problem: dict[str, Any] = Field(default_factory=dict, description="keys of [problem] that differ for this agent")
    plants: dict[str, dict[str, Any]] = Field(default_factory=dict, description="keys of [plants.NAME] that differ")
    exchange: Activation = Field(default_factory=Activation, description="its activations in asynchronous mode")
    faults: AgentFaults = Field(default_factory=AgentFaults, description="crash, pause, slow")


@dataclass(frozen=True)
class AgentSpec:
    """One agent with all choices resolved.

    Attributes:
        id: Id of the agent.
        start: Position before the first step, m; empty without a plant.
        plant: Kind and options of its plant; None for an agent that only computes.
        problem: Kind and options of its share of the problem.
        faults: Faults of the agent.
    """

    id: int
    start: Vector
    plant: Kind | None
    problem: Kind
    faults: AgentFaults


def default_controller(*, has_plants: bool) -> str:
    """Return the kind of controller of a fleet file that names none."""
    return "receding_horizon" if has_plants else "solve_once"


class FleetSpec(Table):
    """A fleet file, complete with all defaults."""

    name: Name = Field(description="part of the keys on the wire and of the names of run directories")
    seed: Annotated[int, Field(ge=0)] = 0
    plant: str | None = Field(default=None, description="plant of every agent that names none")
    arena: Arena | None = Field(default=None, description="where agents may be; see safety.geofence")
    time: Time = Field(default_factory=Time)
    exchange: Rounds = Field(default_factory=Rounds)
    topology: Topology = Field(default_factory=Topology)
    problem: Kind
    algorithm: Kind
    algorithms: dict[str, Kind] = Field(default_factory=dict, description="others, chosen by --algorithm NAME")
    controller: Kind | None = Field(default=None, description="none: receding_horizon with plants, solve_once without")
    plants: dict[str, Kind] = Field(default_factory=dict, description="plants by name")
    agents: Annotated[dict[AgentId, AgentTable], Field(min_length=1)]
    faults: Faults = Field(default=Faults(), description="what the network does to messages")
    safety: Safety = Field(default_factory=Safety)
    log: Log = Field(default_factory=Log)
    zenoh: NetworkTable = Field(default_factory=NetworkTable)

    @property
    def ids(self) -> tuple[int, ...]:
        """Ids of all agents, ascending."""
        return tuple(sorted(self.agents))

    @property
    def has_plants(self) -> bool:
        """Whether the agents have plants."""
        return self.plant is not None or any(own.plant is not None for own in self.agents.values())

    @property
    def steps(self) -> int:
        """Number of control steps; a fleet without plants solves its problem once."""
        return self.time.steps if self.has_plants else 1

    @property
    def controller_kind(self) -> Kind:
        """Controller: that of the file, or the default for a fleet with or without plants."""
        return self.controller or Kind(kind=default_controller(has_plants=self.has_plants))

    def activation(self, agent: int) -> Activation:
        """Return period and jitter of one agent in asynchronous mode, neither None.

        Without a period in the file, it is budget / max_rounds.
        """
        own, fleet = self.agents[agent].exchange, self.exchange
        period = fleet.step_budget(self.time.sample_time) / fleet.max_rounds if fleet.period is None else fleet.period
        return Activation(
            period=period if own.period is None else own.period,
            jitter=fleet.jitter if own.jitter is None else own.jitter,
        )

    def agent(self, agent: int) -> AgentSpec:
        """Return one agent with all choices resolved: its own keys merged into those of the fleet."""
        own = self.agents[agent]
        problem = own.problem if own.target is None else {"target": own.target, **own.problem}
        name = own.plant or self.plant
        plant = None if name is None else self.plants[name].with_options(own.plants.get(name, {}))
        return AgentSpec(agent, own.start or (), plant, self.problem.with_options(problem), own.faults)
