"""Control steps of a run once more, as they would have been with a perfect network and nobody absent."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from dcf_zenoh.agent_log import AgentLog
from dcf_zenoh.assembly import AgentParts, Blueprint
from dcf_zenoh.config import LoadedFleet, load
from dcf_zenoh.messaging.message import Last
from dcf_zenoh.plant import Array, Plant, Setpoint, State, read_only
from dcf_zenoh.plugins import load as load_plugin
from dcf_zenoh.requests import Loop, Start
from dcf_zenoh.run import Run
from dcf_zenoh.simulation import run_agents
from dcf_zenoh.spec import AgentFaults, Faults, FleetSpec, Kind, Rounds

ROUNDS = 2000  # at most
_CLOSER = 0.01  # of the fleet's threshold: the iteration starts from nothing, not from the last step's result
_FREE_BODY = Kind(kind="dcf_zenoh.replay:FreeBody")


@dataclass(frozen=True)
class Replay:
    """What came of it.

    Attributes:
        first: The first control step that was replayed.
        end: The step before which it ended.
        states: Agent -> position and velocity at `end`, shape (2 d,), m and m/s.
        rounds: Communication rounds of the step that took most.
        agreed: The fleet agreed in every step that it had converged.
        free: Agents whose plant could not go on from a recorded state; free bodies stood in for them.
    """

    first: int
    end: int
    states: Mapping[int, Array]
    rounds: int
    agreed: bool
    free: tuple[int, ...]


class FreeBody(Plant):
    """A point without bounds or drag: whatever acceleration it is told, it has.

    It stands in for bodies that cannot be put into a recorded state, real ones above all.

    Args:
        start: Position, shape (d,), m.
    """

    def __init__(self, start: Array) -> None:
        self._state = State(read_only(start), np.zeros_like(start))
        self._acceleration = np.zeros_like(start)
        self._now = 0

    def resume(self, state: State, now: int) -> None:
        """Go on from `state`."""
        self._state, self._now = state, now

    def sense(self, now: int) -> State:
        """The exact solution under constant acceleration."""
        duration = (now - self._now) * 1e-9
        change = self._acceleration * duration
        position = self._state.position + (self._state.velocity + change / 2) * duration
        self._state, self._now = State(read_only(position), read_only(self._state.velocity + change)), now
        return self._state

    def act(self, setpoint: Setpoint, now: int) -> None:
        """Accelerate as told, in as many dimensions as the setpoint has; without acceleration, rest at once."""
        state = self.sense(now)
        self._acceleration = np.zeros_like(state.position)
        if setpoint.acceleration is None:
            self._state = State(state.position, np.zeros_like(state.velocity))
        else:
            self._acceleration[: len(setpoint.acceleration)] = setpoint.acceleration


def replay(run: Run, first: int, end: int) -> Replay:
    """Compute steps `first` to `end` - 1 of `run` again, from the states that were recorded at the first one.

    All agents take part, no message is lost or late, and there are as many rounds as it takes; setpoints act at once.
    What the agents remembered of earlier steps is not known, so the iteration starts from nothing. Nothing but
    simulated plants is moved, and nothing of them is asked for that connects to hardware.

    Args:
        run: Fleet file and plug-ins are taken from its directory.
        first: A step that the run has.
        end: A later one, or the one after its last.

    Raises:
        DcfError: The fleet file or a plug-in cannot be loaded, or something stopped an agent.
    """
    fleet = LoadedFleet(run.fleet, Path(), run.name) if run.folder is None else load(run.folder / "fleet.toml")
    free = tuple(i for i in fleet.spec.ids if not _resumable(fleet, i))
    blueprint = Blueprint.of(replace(fleet, spec=_undisturbed(fleet.spec, end - first, free)))
    streams = {i: BytesIO() for i in fleet.spec.ids}
    with threadpool_limits(1):
        parts = []
        for i, stream in streams.items():
            part = blueprint.build(i, stream, {"run": run.name})
            state = None if fleet.spec.agent(i).plant is None else _recorded(run, i, first)
            parts.append(part if state is None else replace(part, loop=_from(state, part)))
        run_agents(parts, blueprint.graph)
    logs = [AgentLog.read(stream.getvalue(), f"agent {i}") for i, stream in streams.items()]
    ends = {log.agent: log.end["state"] for log in logs if log.end}
    return Replay(
        first=first,
        end=end,
        states={i: read_only(state) for i, state in ends.items()},
        rounds=max(int(log.rounds.max()) for log in logs),
        agreed=all(word in ("agreed", "returned") for log in logs for word in log.stopped_by),
        free=free,
    )


def _undisturbed(spec: FleetSpec, steps: int, free: tuple[int, ...]) -> FleetSpec:
    """The fleet for some steps in virtual time, without faults."""
    agents = {}
    for i, own in spec.agents.items():
        changes: dict[str, object] = {"faults": AgentFaults()}
        if i in free:
            changes |= {"plant": "free", "plants": {}}
        agents[i] = own.model_copy(update=changes)
    exchange = Rounds(
        max_rounds=ROUNDS, threshold=_CLOSER * spec.exchange.threshold, margin=0, budget=3600.0,
        missing=spec.exchange.missing, late=spec.exchange.late,
    )  # fmt: skip
    time = spec.time.model_copy(update={"clock": "virtual", "duration": steps * spec.time.sample_time, "arrived": None})
    return spec.model_copy(
        update={
            "agents": agents,
            "exchange": exchange,
            "faults": Faults(),
            "plants": {**spec.plants, "free": _FREE_BODY},
            "time": time,
        }
    )


def _resumable(fleet: LoadedFleet, agent: int) -> bool:
    """Whether the agent's plant can be put into a state; one without a `resume` of its own cannot, hardware say."""
    kind = fleet.spec.agent(agent).plant
    plugin = None if kind is None else load_plugin("plants", kind.kind, fleet.folder)
    return kind is None or getattr(plugin, "resume", Plant.resume) is not Plant.resume


def _recorded(run: Run, agent: int, step: int) -> State | None:
    """The state at the beginning of `step`, or the last one before; None for an agent without a log."""
    log = run.agents.get(agent)
    if log is None or not len(log.step):
        return None
    position, velocity = np.split(log.state[log.rows(step + 1)[step]], 2)
    return State(read_only(position), read_only(velocity))


def _from(state: State, part: AgentParts) -> Loop[Last]:
    """The loop of an agent, whose body is put into `state` before it senses anything."""
    reply: int | None = None
    started = False
    while True:
        try:
            request = part.loop.send(reply)  # type: ignore[arg-type]
        except StopIteration as finished:
            last: Last = finished.value
            return last
        if started:
            part.plant.resume(state, 0)
            started = False
        started = isinstance(request, Start)
        reply = yield request
