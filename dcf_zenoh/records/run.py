"""A finished or interrupted run as arrays, to measure, plot and compare."""

import hashlib
import json
import logging
import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dcf_zenoh.analysis.diagnosis import Diagnosis, diagnose, without_states
from dcf_zenoh.analysis.findings import Finding, findings_of
from dcf_zenoh.analysis.motion import BodyMotion, Course, below_zero, course, replayed
from dcf_zenoh.config import load
from dcf_zenoh.configuration.building.geometry import FleetGeometry
from dcf_zenoh.errors import RecordingError
from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.records.agent_log import AgentLog, has_log
from dcf_zenoh.records.log_writer import log_name
from dcf_zenoh.spec import FleetSpec

log = logging.getLogger(__name__)


class ClosestApproach(NamedTuple):
    """Closest approach of a run.

    Attributes:
        quantity: 'distance', 'barrier' or 'clearance'.
        agents: The two agents; of a clearance the agent and the number of the obstacle, from 0.
        value: Least value.
        time: Fleet time of it, s.
        between: Whether the path between the samples was taken into account.
    """

    quantity: str
    agents: tuple[int, ...]
    value: float
    time: float
    between: bool


class Violation(NamedTuple):
    """Time in which an agent was in the safety region of another, or in an obstacle.

    Attributes:
        quantity: 'barrier' or 'clearance'.
        agents: As in `ClosestApproach`.
        since: Begin, fleet time, s.
        duration: Length, s.
        value: Least barrier value.
    """

    quantity: str
    agents: tuple[int, ...]
    since: float
    duration: float
    value: float


@dataclass(frozen=True)
class Run:
    """Logs of all agents of one run, and the fleet.

    Attributes:
        name: Name of the run.
        fleet: The resolved fleet.
        agents: Id -> log, ascending.
        folder: The run directory; None for a run that was only kept in memory.
        home: Folder that the paths in the fleet are relative to.
        run_plugins: Whether the code of plug-ins that are not part of dcf-zenoh may be run, to learn the `geometry`.
    """

    name: str
    fleet: FleetSpec
    agents: Mapping[int, AgentLog]
    folder: Path | None = None
    home: Path = Path()
    run_plugins: bool = True

    @classmethod
    def read(cls, folder: str | Path, *, run_plugins: bool = True) -> "Run":
        """Read a run directory. No plug-in is run before the `geometry` is asked for.

        Args:
            folder: The directory.
            run_plugins: Whether its copies of plug-ins may be run then.

        Raises:
            RecordingError: It is no run directory, or has no log that can be read.
            ConfigurationError: Its fleet file cannot be read.
        """
        folder = Path(folder)
        if not folder.exists():
            raise RecordingError(f"{folder}: there is no such directory; expected that of a run")
        if not (folder / "fleet.toml").is_file():
            raise RecordingError(f"{folder}: not a run directory: it has no fleet.toml")
        fleet = load(folder / "fleet.toml", run_plugins=False).spec
        found = [i for i in fleet.ids if has_log(folder, i)]
        if not found:
            raise RecordingError(
                f"{folder}: not one log of agents {list(fleet.ids)}; expected files like {log_name(1)}"
            )
        logs = {}
        problems = []
        for i in found:  # one log that cannot be read costs one agent
            try:
                logs[i] = AgentLog.load(folder, i, fleet)
            except RecordingError as error:
                problems.append(str(error))
                log.warning("%s", error)
        for each in logs.values():
            if each.damage:
                log.warning("%s; what follows is left out", each.damage)
        if not logs:
            raise RecordingError("; ".join(problems))
        return cls(folder.resolve().name, fleet, logs, folder, folder, run_plugins)

    @property
    def about(self) -> Mapping[str, Any]:
        """Notes of the launcher about the run (``run.json``); empty if there are none."""
        path = None if self.folder is None else self.folder / "run.json"
        if path is None or not path.is_file():
            return {}
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return found

    @cached_property
    def steps(self) -> int:
        """Number of steps up to the last that an agent recorded."""
        return max((int(log.step[-1]) + 1 for log in self.agents.values() if len(log.step)), default=0)

    @cached_property
    def common_steps(self) -> int:
        """Number of steps up to the last that all agents reached."""
        return min(int(log.step[-1]) + 1 if len(log.step) else 0 for log in self.agents.values())

    @cached_property
    def time(self) -> Array:
        """Nominal instants t_k of the steps, s, shape (K,)."""
        return read_only(np.arange(self.steps) * self.fleet.time.sample_time)

    @cached_property
    def positions(self) -> Array:
        """Measured positions, shape (K, N, d), m, in the d dimensions that all agents have; d = 0 without plants.

        A body stays where its log leaves it: one that has ended, landed or died is still there. One that has recorded
        no step is at its start in the fleet file. NaN where that is not known either.
        """
        return np.stack([self._sampled[i].at(self.time) for i in self.agents], axis=1)

    @cached_property
    def _sampled(self) -> Mapping[int, BodyMotion]:
        """Motion of every body from sample to sample."""
        known = [log.path.shape[1] for log in self.agents.values() if len(log.step)]
        d = min(known, default=0)
        return {i: self._samples_of(log, d) for i, log in self.agents.items()}

    def _samples_of(self, log: AgentLog, d: int) -> BodyMotion:
        if len(log.step):
            return BodyMotion.samples(log.path[:, :d], log.step, self.fleet.time.sample_time)
        start = self.fleet.agent(log.agent).start
        return BodyMotion.resting(np.array(start[:d]) if len(start) >= d else np.full(d, np.nan))

    @cached_property
    def motions(self) -> Mapping[int, BodyMotion]:
        """Agent -> motion of its body: the path between the samples where a simulated plant offers it."""
        found = {}
        for i, sampled in self._sampled.items():
            log, d = self.agents[i], sampled.terms.shape[2]
            path = None
            if d and len(log.step):
                path = replayed(log, self.fleet, self.home, d, run_plugins=self.run_plugins)
            found[i] = path or sampled
        return found

    @cached_property
    def courses(self) -> Mapping[str, Mapping[tuple[int, ...], Course]]:
        """'distance', 'barrier' and 'clearance' -> pair -> its values over all time, between the samples if known.

        The pair of a clearance is an agent and the number of an obstacle. A quantity that the run does not have is
        empty.
        """
        found: dict[str, dict[tuple[int, ...], Course]] = {"distance": {}, "barrier": {}, "clearance": {}}
        if not self.positions.size:
            return found
        samples = np.append(self.time, self.steps * self.fleet.time.sample_time)
        for pair in combinations(self.agents, 2):
            one, other = (self.motions[i] for i in pair)
            found["distance"][pair] = course(one, other, _distance, samples)
            if self.barriers.size:
                found["barrier"][pair] = course(one, other, partial(self._barrier, pair), samples)
        for i in self.agents if self.clearances.size else ():
            for number, corners in enumerate(self.geometry.obstacles):
                centre = np.zeros(self.motions[i].terms.shape[2])
                centre[:2] = corners.mean(axis=0)
                clearance = partial(self._clearance, i, number)
                found["clearance"][i, number] = course(self.motions[i], BodyMotion.resting(centre), clearance, samples)
        return found

    def _barrier(self, pair: tuple[int, int], one: Array, other: Array) -> Array:
        values = self.geometry.separation(pair, one, other)
        return np.full(len(one), np.nan) if values is None else values

    def _clearance(self, agent: int, number: int, position: Array, _obstacle: Array) -> Array:
        values = self.geometry.clearances(agent, position)
        return np.full(len(position), np.nan) if values is None else values[:, number]

    def closest(self, quantity: str = "") -> ClosestApproach | None:
        """Return the closest approach of all pairs over the whole run; None if the run does not have the quantity.

        Args:
            quantity: 'distance' (m), 'barrier' or 'clearance'; empty: the barrier value of pairs, or their distance
                where there is no safety region.
        """
        quantity = quantity or ("barrier" if self.courses["barrier"] else "distance")
        courses = {pair: each for pair, each in self.courses[quantity].items() if np.isfinite(each.values).any()}
        if not courses:
            return None
        pair = min(courses, key=lambda each: float(np.nanmin(courses[each].values)))
        way = courses[pair]
        place = int(np.nanargmin(way.values))
        return ClosestApproach(quantity, pair, float(way.values[place]), float(way.times[place]), way.between)

    @cached_property
    def between_samples(self) -> bool:
        """Whether the closest approach is that between the samples too, for all bodies."""
        return all(motion.known for motion in self.motions.values())

    @cached_property
    def violations(self) -> tuple[Violation, ...]:
        """Times in which a barrier value was negative, in the order of their begin."""
        found = []
        for quantity in ("barrier", "clearance"):
            for pair, way in self.courses[quantity].items():
                found += [Violation(quantity, pair, *each) for each in below_zero(way)]
        return tuple(sorted(found, key=lambda each: (each.since, each.agents)))

    @cached_property
    def distances(self) -> Array:
        """Distance of every pair of agents, pairs in order of ids, shape (K, pairs), m; no columns without plants."""
        if not self.positions.size:
            return np.empty((self.steps, 0))
        pairs = list(combinations(range(len(self.agents)), 2))
        gaps = [np.linalg.norm(self.positions[:, i] - self.positions[:, j], axis=1) for i, j in pairs]
        return np.stack(gaps, axis=1) if gaps else np.empty((self.steps, 0))

    @cached_property
    def geometry(self) -> FleetGeometry:
        """Safety regions and obstacles, as the problems of the agents define them."""
        return FleetGeometry.of(self.fleet, self.home, run_plugins=self.run_plugins)

    @cached_property
    def barriers(self) -> Array:
        """Barrier value h of every pair, pairs in order of ids, shape (K, pairs); no columns without safety regions."""
        if not self.positions.size:
            return np.empty((self.steps, 0))
        places = dict(zip(self.agents, self.positions.swapaxes(0, 1), strict=True))
        values = [self.geometry.separation((i, j), places[i], places[j]) for i, j in combinations(places, 2)]
        return _columns(self.steps, values) if all(each is not None for each in values) else np.empty((self.steps, 0))

    @cached_property
    def clearances(self) -> Array:
        """Barrier value h of every agent with every obstacle, shape (K, N obstacles); no columns without obstacles.

        The columns are ordered by obstacle, then by agent.
        """
        if not self.positions.size:
            return np.empty((self.steps, 0))
        values = [
            self.geometry.clearances(i, path)
            for i, path in zip(self.agents, self.positions.swapaxes(0, 1), strict=True)
        ]
        found = [each for each in values if each is not None]
        most = max((each.shape[1] for each in found), default=0)
        return _columns(self.steps, [each[:, m] for m in range(most) for each in found if m < each.shape[1]])

    @cached_property
    def targets(self) -> Mapping[int, Array]:
        """Agent -> target, m, of the agents that have a target."""
        found = {i: self.fleet.agent(i).problem.options.get("target") for i in self.agents}
        return {i: read_only(target) for i, target in found.items() if target is not None}

    @cached_property
    def arrival_time(self) -> float | None:
        """Begin of the first time in which all agents were at their targets as long as the fleet file asks, s, or None.

        Where the targets are not in the fleet file, because agents agree on them in flight, the ends of the logs count.
        None if an agent has no log: whether it arrived is not known.
        """
        rule = self.fleet.time.arrived
        if rule is None or not self.common_steps or len(self.agents) < len(self.fleet.agents):
            return None
        if set(self.targets) != set(self.agents):
            ends = [log.end for log in self.agents.values()]
            agreed = [end["time"] * 1e-9 - rule.for_ for end in ends if end is not None and end["end"] == "arrived"]
            return min(agreed) if len(agreed) == len(ends) else None
        goals = np.stack([self.targets[i] for i in self.agents])
        near = (
            np.linalg.norm(self.positions[: self.common_steps, :, : goals.shape[1]] - goals, axis=2) <= rule.within
        ).all(axis=1)
        since = None
        for instant, close in zip(self.time[: self.common_steps], near, strict=True):
            since = (instant if since is None else since) if close else None
            if since is not None and instant - since >= rule.for_ - 1e-9:
                return float(since)
        return None

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the states, setpoints, decisions and rounds of every step, without times."""
        total = hashlib.sha256()
        for agent, log in sorted(self.agents.items()):
            total.update(struct.pack("<qq", agent, len(log.step)))
            for table in (log.state, log.setpoint, log.decision):
                total.update(np.ascontiguousarray(table, dtype="<f8").tobytes())
            total.update(log.rounds.astype("<i8").tobytes())
        return total.hexdigest()

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """Findings on the run: violations of safety regions, agents that did not arrive, missed deadlines, messages."""
        return findings_of(self)

    @cached_property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """Causes of steps that ended otherwise than by agreement."""
        return diagnose(self)

    @cached_property
    def endings(self) -> Mapping[str, int]:
        """Reason for the end of a step's rounds -> number of agent-steps.

        Reasons are those of `Outcome.stopped_by`, and 'states' where states of other agents were missing.
        """
        words = (
            "states" if lacking else word
            for log in self.agents.values()
            for word, lacking in zip(log.stopped_by, without_states(log), strict=True)
        )
        return dict(sorted(Counter(words).items()))

    @property
    def gaps(self) -> list[str]:
        """Texts on agents whose log is missing, breaks off or is damaged. Empty if the run is `complete`."""
        absent = [f"agent {i} has no log that can be read" for i in self.fleet.ids if i not in self.agents]
        broken = [
            f"agent {i}'s log {'is damaged' if log.damage else 'breaks off'} after {_last_step(log)}"
            for i, log in self.agents.items()
            if log.end is None
        ]
        return absent + broken

    @property
    def complete(self) -> bool:
        """Whether every agent recorded its end."""
        return len(self.agents) == len(self.fleet.agents) and all(log.end for log in self.agents.values())

    def _least(self, quantity: str) -> float | None:
        found = self.closest(quantity)
        return None if found is None else found.value

    def summary(self) -> dict[str, Any]:
        """Return the run in single numbers, as ``--json`` prints it."""
        logs = self.agents.values()
        received, missing, late, lost = (
            int(sum(counts[:, column].sum() for log in logs for counts in log.links.values())) for column in range(4)
        )
        never_came = sum(log.counts.get("lost", 0) for log in logs)
        lost_by = Counter(each.lost_by for log in logs for each in log.passed if each.lost_by)
        unmet = Counter(f"{fault}: {what}" for log in logs if log.end for _, fault, what in log.end["unmet"])
        notes: Counter[str] = Counter()
        for each in (each for log in logs for each in log.notes):
            notes.update(each)
        alarms = Counter(event["rule"] for log in logs for event in log.events if event["event"] == "alarm")
        plants = {spec.plant.kind if spec.plant else "none" for spec in map(self.fleet.agent, self.fleet.ids)}
        return {
            "fleet": self.fleet.name,
            "run": self.name,
            "clock": self.fleet.time.clock,
            "plant": ", ".join(sorted(plants)),
            "topology": self.fleet.topology.kind,
            "agents": len(self.fleet.agents),
            "steps": self.steps,
            "steps_of_all": self.common_steps,
            "arrived": self.arrival_time is not None,
            "arrival_time": self.arrival_time,
            "min_barrier": self._least("barrier"),
            "min_clearance": self._least("clearance"),
            "min_distance": self._least("distance"),
            "between_samples": self.between_samples,
            "rounds_per_step": spread_of(np.concatenate([log.rounds for log in logs])),
            "compute_ms": spread_of(np.concatenate([log.compute for log in logs]) * 1e3),
            "negotiation_ms": spread_of(np.concatenate([log.negotiation for log in logs]) * 1e3),
            "ended_by": self.endings,
            "deadline_misses": int(sum(log.late.sum() for log in logs)),
            "messages": {
                "published": sum(log.counts.get("published", 0) for log in logs),
                "delivered": received + late,
                "lost": lost + never_came,
                "late": late,
                "missing": missing,
            },
            "landed": {str(i): log.landed for i, log in self.agents.items() if log.landed},
            "alarms": dict(sorted(alarms.items())),
            "lost_by": {"faults": dict(sorted(lost_by.items())), "network": never_came},
            "unmet": dict(sorted(unmet.items())),
            "notes": dict(sorted(notes.items())),
            "diagnosis": [each._asdict() for each in self.diagnosis],
            "findings": [{"kind": each.kind, "text": each.text} for each in self.findings],
            "digest": self.digest,
        }


def _distance(one: Array, other: Array) -> Array:
    gaps: Array = np.linalg.norm(one - other, axis=1)
    return gaps


def _columns(rows: int, columns: Sequence[Array | None]) -> Array:
    """Return a table of `columns`, each of shape (rows,), without those that are None."""
    known = [each for each in columns if each is not None]
    return np.stack(known, axis=1) if known else np.empty((rows, 0))


def _last_step(log: AgentLog) -> str:
    return f"step {log.step[-1]}" if len(log.step) else "nothing"


def spread_of(values: npt.NDArray[Any]) -> dict[str, float | None]:
    """Return median, 95th percentile and maximum; None where there are no values."""
    if not values.size:
        return {"median": None, "p95": None, "max": None}
    return {
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "max": float(values.max()),
    }
