"""Control steps of a run computed again, with a perfect network and all agents present."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from dcf_zenoh.assembly import Blueprint
from dcf_zenoh.config import LoadedFleet, load
from dcf_zenoh.plant import Array, Plant, Setpoint, State, read_only
from dcf_zenoh.plugins import create
from dcf_zenoh.plugins import load as load_plugin
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.run import Run
from dcf_zenoh.simulation import run_agents
from dcf_zenoh.spec import AgentFaults, Faults, FleetSpec, Kind, Rounds, nanoseconds

ROUNDS = 2000  # at most
_CLOSER = 0.01  # factor on the fleet's threshold: the replay compares with the agreement, not with an approximation


@dataclass(frozen=True)
class Replay:
    """Result of a replay.

    Attributes:
        first: First control step that was replayed.
        end: Step before which the replay ended.
        states: Agent -> position and velocity at `end`, shape (2 d,), m and m/s.
        rounds: Largest number of communication rounds in a step.
        agreed: Whether the fleet agreed in every step that it had converged.
        free: Agents whose plant could not continue from a recorded state; a `FreeBody` replaced it.
    """

    first: int
    end: int
    states: Mapping[int, Array]
    rounds: int
    agreed: bool
    free: tuple[int, ...]


def replay(run: Run, first: int, end: int) -> Replay:
    """Compute steps `first` to `end` - 1 of `run` again, from the states that were recorded at the first one.

    All agents take part, no message is lost or late, and there are as many rounds as the agreement takes. Setpoints act
    as long after the measurement as they did in the run, so only the decisions differ. The memory of the agents from
    earlier steps is not in the logs; so they compute the step before `first` too, without effect on the bodies.

    Only simulated plants that can continue from a state are used. They are not prepared, so no plant connects to
    hardware.

    Args:
        run: The run; fleet file and plug-ins are taken from its directory.
        first: A step of the run.
        end: A later step, or the one after its last.

    Raises:
        DcfError: The fleet file or a plug-in cannot be loaded, or an agent fails.
    """
    fleet = LoadedFleet(run.fleet, run.home, run.name) if run.folder is None else load(run.folder / "fleet.toml")
    free = tuple(i for i in fleet.spec.ids if not _resumable(fleet, i))
    steps = range(max(0, first - 1), end)
    bodies = {
        i: _body(run, fleet, i, steps, first, free=i in free)
        for i in fleet.spec.ids
        if fleet.spec.agent(i).plant is not None
    }
    blueprint = Blueprint.of(replace(fleet, spec=_undisturbed(fleet.spec, len(steps), bodies)))
    streams = {i: BytesIO() for i in fleet.spec.ids}
    with threadpool_limits(1):
        run_agents([blueprint.build(i, stream, {"run": run.name}) for i, stream in streams.items()], blueprint.graph)
    logs = [AgentLog.read(stream.getvalue(), f"agent {i}") for i, stream in streams.items()]
    return Replay(
        first=first,
        end=end,
        states={log.agent: read_only(log.end["state"]) for log in logs if log.end},
        rounds=max(int(log.rounds.max()) for log in logs),
        agreed=all(word in ("agreed", "returned") for log in logs for word in log.stopped_by),
        free=free,
    )


@dataclass(frozen=True)
class BodyOptions:
    """Plant that a replay moves.

    Attributes:
        kind: Kind of the plant.
        folder: Folder that paths are relative to.
        options: Keys of the plant.
    """

    kind: str
    folder: str
    options: dict[str, Any]


@dataclass(frozen=True)
class RecordedMotion:
    """Motion of an agent before a replay, and the delays of its setpoints.

    Attributes:
        states: Position and velocity at each step before the body moves, and at the first one in which it does, m, m/s.
        flown: Position, velocity and acceleration (empty: at rest) of the setpoint that acts then; empty if none does.
        delays: Time from the measurement until the setpoint acts, of each step from then on, ns.
    """

    states: tuple[tuple[float, ...], ...]
    flown: tuple[tuple[float, ...], ...]
    delays: tuple[int, ...]


class ResumedPlant(Plant):
    """A plant that continues from a recorded state, with the recorded delays of setpoints.

    Args:
        agent: Id of the agent.
        start: Position, shape (d,), m; passed on to the body.
        sample_time: t_s, s; passed on to the body.
        rng: Passed on to the body.
        body: The body.
        recorded: Motion and delays of the run.
    """

    def __init__(
        self,
        agent: int,
        start: Array,
        sample_time: float,
        rng: np.random.Generator,
        *,
        body: BodyOptions,
        recorded: RecordedMotion,
    ) -> None:
        known = {"agent": agent, "start": start, "sample_time": sample_time, "rng": rng}
        plugin = load_plugin("plants", body.kind, Path(body.folder))
        self._body: Plant = create(plugin, known, body.options, f"agents.{agent}: plant")
        self._before = [State(*map(read_only, np.split(np.array(state), 2))) for state in recorded.states]
        self._begin = (len(recorded.states) - 1) * nanoseconds(sample_time)
        self._flown = [read_only(each) for each in recorded.flown]
        self._delays = list(recorded.delays)
        self._pending: list[tuple[int, Setpoint]] = []
        self._sensed = 0

    def sense(self, now: int) -> State:
        """Return the recorded state, and from the first replayed step on that of the body."""
        self._sensed = now
        if now < self._begin:
            return self._before.pop(0)
        if self._before:
            self._body.resume(self._before.pop(), now)
            if self._flown:
                position, velocity, acceleration = self._flown
                self._body.act(Setpoint(position, velocity, acceleration if acceleration.size else None), now)
        while self._pending and self._pending[0][0] <= now:
            instant, setpoint = self._pending.pop(0)
            self._body.act(setpoint, instant)
        return self._body.sense(now)

    def act(self, setpoint: Setpoint, now: int) -> None:
        """Keep the setpoint until its recorded delay is over; before the first replayed step discard it."""
        if now >= self._begin:
            self._pending.append((max(now, self._sensed + self._delays.pop(0)), setpoint))


class FreeBody(Plant):
    """A point without bounds or drag that has the acceleration of its setpoint.

    It replaces bodies that cannot be put into a recorded state, such as real ones.

    Args:
        start: Position, shape (d,), m.
    """

    def __init__(self, start: Array) -> None:
        self._state = State(read_only(start), np.zeros_like(start))
        self._acceleration = np.zeros_like(start)
        self._now = 0

    def resume(self, state: State, now: int) -> None:
        """Continue from `state`."""
        self._state, self._now = state, now
        self._acceleration = np.zeros_like(state.position)

    def sense(self, now: int) -> State:
        """Return the state, by the exact solution under constant acceleration."""
        duration = (now - self._now) * 1e-9
        change = self._acceleration * duration
        position = self._state.position + (self._state.velocity + change / 2) * duration
        self._state, self._now = State(read_only(position), read_only(self._state.velocity + change)), now
        return self._state

    def act(self, setpoint: Setpoint, now: int) -> None:
        """Take over the acceleration, in as many dimensions as the setpoint has; without one, come to rest at once."""
        state = self.sense(now)
        self._acceleration = np.zeros_like(state.position)
        if setpoint.acceleration is None:
            self._state = State(state.position, np.zeros_like(state.velocity))
        else:
            self._acceleration[: len(setpoint.acceleration)] = setpoint.acceleration


def _resumable(fleet: LoadedFleet, agent: int) -> bool:
    """Return whether the agent's plant can continue from a state: whether it overrides `resume`."""
    kind = fleet.spec.agent(agent).plant
    plugin = None if kind is None else load_plugin("plants", kind.kind, fleet.folder)
    return kind is None or getattr(plugin, "resume", Plant.resume) is not Plant.resume


def _body(run: Run, fleet: LoadedFleet, agent: int, steps: range, first: int, *, free: bool) -> Kind:
    """Return the plant of an agent for a replay of `steps`; it moves from step `first` on."""
    own, log = fleet.spec.agent(agent), run.agents.get(agent)
    assert own.plant is not None
    states, flown = [[*own.start, *[0.0] * len(own.start)]] * (first - steps.start + 1), []
    if log is not None and len(log.step):  # else it stayed at its start
        rows = log.rows(steps.stop)
        states = log.state[rows[steps.start : first + 1]].tolist()
        if first:
            flown = [part[np.isfinite(part)].tolist() for part in np.split(log.setpoint[rows[first - 1]], 3)]
    return Kind.model_validate(
        {
            "kind": "dcf_zenoh.analysis.replay:ResumedPlant",
            "body": {
                "kind": "dcf_zenoh.analysis.replay:FreeBody" if free else own.plant.kind,
                "folder": str(fleet.folder.resolve()),
                "options": {} if free else own.plant.options,
            },
            "recorded": {
                "states": states,
                "flown": flown,
                "delays": [_delay(run, agent, step) for step in range(first, steps.stop)],
            },
        }
    )


def _delay(run: Run, agent: int, step: int) -> int:
    """Return the time from measurement to setpoint, ns; for an absent agent the median of the others."""
    found = {
        log.agent: float(log.negotiation[row])
        for log in run.agents.values()
        for row in np.flatnonzero(log.step == step)
        if log.stopped_by[row] != "abstained"
    }
    delay = found.get(agent, float(np.median(list(found.values()))) if found else 0.0)
    return nanoseconds(min(delay, run.fleet.time.sample_time))


def _undisturbed(spec: FleetSpec, steps: int, bodies: Mapping[int, Kind]) -> FleetSpec:
    """Return the fleet for some steps in virtual time, without faults, with other bodies."""
    agents = {}
    for i, own in spec.agents.items():
        plant = {"plant": f"replay-{i}", "plants": {}} if i in bodies else {}
        agents[i] = own.model_copy(update={"faults": AgentFaults(), **plant})
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
            "plants": {f"replay-{i}": body for i, body in bodies.items()},
            "time": time,
        }
    )
