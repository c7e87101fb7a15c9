"""Motion of bodies between their samples, replayed from the recorded setpoints, and the course of a pair."""

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from dcf_zenoh.configuration.building.problem_and_plant import plant_of
from dcf_zenoh.diagnostics import reason
from dcf_zenoh.plant import Array, KnownPath, Piece, Plant, Setpoint, State, read_only
from dcf_zenoh.plugins import is_built_in, load
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.spec import FleetSpec

log = logging.getLogger(__name__)

Measure: TypeAlias = Callable[[Array, Array], Array]  # positions (n, d) of two bodies -> value (n,)
_SAME = 1e-6  # m and m/s; further from its recorded states a replayed body is not the one of the run
_ROUNDS = 4  # of parabolic interpolation
_PARTS = 8  # parts of a smooth stretch, each taken for a parabola: exact for |dx| / r1 + |dy| / r2 - 1


@dataclass(frozen=True)
class BodyMotion:
    """Position of one body over time, in pieces of constant acceleration. It rests before the first and after the last.

    Attributes:
        begin: Fleet time at which each piece begins, s, ascending, shape (P,).
        terms: Position, velocity and acceleration at the begin of each piece, shape (P, 3, d).
        known: Whether this is the path between the samples; otherwise it jumps from sample to sample.
    """

    begin: Array
    terms: Array
    known: bool

    def at(self, times: Array) -> Array:
        """Return the positions at `times`, s, shape (n, d), m."""
        piece = (np.searchsorted(self.begin, times, side="right") - 1).clip(0)
        since = np.maximum(times - self.begin[piece], 0.0)[:, np.newaxis]
        position, velocity, acceleration = self.terms[piece].swapaxes(0, 1)
        result: Array = position + (velocity + acceleration * since / 2) * since
        return result

    @classmethod
    def samples(cls, path: Array, steps: npt.NDArray[np.int64], sample_time: float) -> "BodyMotion":
        """Return the motion that jumps from sample to sample.

        Samples count as taken when their steps begin, so those of all agents are compared at the same instants.

        Args:
            path: Positions at the steps, and perhaps one more, at the end, shape (K or K + 1, d).
            steps: Step numbers, shape (K,).
            sample_time: t_s, s.
        """
        terms = np.zeros((len(path), 3, path.shape[1]))
        terms[:, 0] = path
        times = np.append(steps, steps[-1] + 1)[: len(path)] * sample_time
        return cls(times, terms, known=False)

    @classmethod
    def resting(cls, position: Array) -> "BodyMotion":
        """Return the motion of a body that stays at a position, shape (d,)."""
        terms = np.zeros((1, 3, len(position)))
        terms[0, 0] = position
        return cls(np.zeros(1), terms, known=True)


class Course(NamedTuple):
    """Values of a pair over time, among them every local minimum.

    Attributes:
        times: Fleet time, s, ascending, shape (n,).
        values: Shape (n,).
        between: Whether the path between the samples is known; otherwise there is one value per sample.
    """

    times: Array
    values: Array
    between: bool


def course(one: BodyMotion, other: BodyMotion, measure: Measure, samples: Array) -> Course:
    """Return the values of a measure on the way of two bodies.

    Between the samples the relative path is a parabola in each of its pieces. These are split where a relative
    coordinate changes its sign; then the barrier value of a diamond is a parabola too, and its least value exact.
    Minima of other measures, such as the distance, follow by parabolic interpolation, to 1e-9.

    Args:
        one: One body.
        other: The other body.
        measure: Positions of both, shape (n, d) each -> values, shape (n,).
        samples: Instants of the samples, s.
    """

    def values_at(times: Array) -> Array:
        return measure(one.at(times), other.at(times))

    if not (one.known and other.known):
        return Course(samples, values_at(samples), between=False)
    times = np.union1d(np.union1d(one.begin, other.begin), samples)
    times = np.union1d(times, _crossings(one, other, times))
    parts = np.linspace(0.0, 1.0, 2 * _PARTS, endpoint=False)
    times = np.unique(np.append((times[:-1, np.newaxis] + np.diff(times)[:, np.newaxis] * parts).ravel(), times[-1]))
    values = values_at(times)
    for _ in range(_ROUNDS):
        low = 1 + np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:]))
        better = _vertices(times, values, low)
        new = better[~np.isin(better, times)]
        order = np.argsort(times := np.append(times, new), kind="stable")
        values = np.append(values, values_at(new))[order]
        times = times[order]
    return Course(times, values, between=True)


def below_zero(way: Course) -> list[tuple[float, float, float]]:
    """Return begin, s, length, s, and least value of each time in which the values are negative.

    Between the samples the ends are interpolated. At the samples a time lasts until the next one that is not negative.
    """
    inside = way.values < 0
    edges = np.flatnonzero(np.diff(np.concatenate(([False], inside, [False])).astype(np.int8)))
    found = []
    for first, end in edges.reshape(-1, 2):
        since, until = float(way.times[first]), float(way.times[min(end, len(inside) - 1)])
        if way.between and first:
            since = _zero(way, first - 1)
        if way.between and end < len(inside):
            until = _zero(way, end - 1)
        found.append((since, until - since, float(way.values[first:end].min())))
    return found


def _zero(way: Course, place: int) -> float:
    """Return the instant of the zero between the values at `place` and `place` + 1, s."""
    one, other = way.values[place], way.values[place + 1]
    return float(way.times[place] + (way.times[place + 1] - way.times[place]) * one / (one - other))


def _crossings(one: BodyMotion, other: BodyMotion, times: Array) -> Array:
    """Return the instants between `times` at which a coordinate of one body passes that of the other, s."""
    begin, length = times[:-1], np.diff(times)
    first, middle, last = (one.at(t) - other.at(t) for t in (begin, begin + length / 2, _before(times[1:])))
    found = []
    for x0, x1, x2 in zip(first.T, middle.T, last.T, strict=True):  # x0 + b s + c s² for s = 0 .. 1
        c, b = 2 * (x0 - 2 * x1 + x2), 4 * x1 - 3 * x0 - x2
        root = np.sqrt(np.maximum(b**2 - 4 * c * x0, 0.0))
        q = -(b + np.where(b >= 0, root, -root)) / 2
        with np.errstate(divide="ignore", invalid="ignore"):
            for share in (q / c, x0 / q):
                inside = (share > 0) & (share < 1)
                found.append(begin[inside] + share[inside] * length[inside])
    return np.concatenate(found) if found else np.empty(0)


def _before(times: Array) -> Array:
    """Return the instants just before `times`, which belong to the piece before."""
    return np.nextafter(times, -np.inf)


def _vertices(times: Array, values: Array, low: npt.NDArray[np.int64]) -> Array:
    """Return the vertices of the parabolas through each of the samples `low` and those next to it."""
    t0, t1, t2 = times[low - 1], times[low], times[low + 1]
    y0, y1, y2 = values[low - 1], values[low], values[low + 1]
    slope_before, slope_after = (y1 - y0) / (t1 - t0), (y2 - y1) / (t2 - t1)
    with np.errstate(divide="ignore", invalid="ignore"):
        vertex = (t0 + t1) / 2 - slope_before * (t2 - t0) / 2 / (slope_after - slope_before)
    found: Array = np.unique(vertex[(vertex > t0) & (vertex < t2)])
    return found


def replayed(log_: AgentLog, spec: FleetSpec, folder: Path, d: int, *, run_plugins: bool) -> BodyMotion | None:
    """Return the path of an agent's body, in the first `d` dimensions, from its setpoints on a fresh plant.

    None if the plant's own class does not offer it (`KnownPath`), its code must not be run, the daemon was started more
    than once, or the replayed body does not pass through the recorded states.
    """
    kind = spec.agent(log_.agent).plant
    if kind is None or log_.lives > 1 or not (run_plugins or is_built_in("plants", kind.kind)):
        return None
    try:
        plugin = load("plants", kind.kind, folder)
        if "path" not in vars(plugin) or getattr(plugin, "real", True):
            return None
        return _replay(log_, plant_of(spec, folder, log_.agent), d)
    except Exception as error:  # the plant of a third party may raise anything; the samples are left
        log.warning("agent %d: its path between the samples is not known: %s", log_.agent, reason(error))
        return None


def _replay(log_: AgentLog, plant: Plant, d: int) -> BodyMotion | None:
    """Return the path of a fresh plant under the recorded setpoints; None if it misses the recorded states."""
    if not isinstance(plant, KnownPath):
        return None
    plant.start(0)
    pieces: list[Piece] = []
    end = log_.end if log_.end is not None and log_.end["state"] else None
    now, state = 0, State()
    for now, expected, setpoint in _timeline(log_, end):
        pieces += plant.path(now)
        if expected is not None:
            state = plant.sense(now)
            if not np.allclose(state.vector, expected, rtol=0.0, atol=_SAME):
                return None
        else:
            plant.act(Setpoint.hold(state) if setpoint is None else setpoint, now)
    path = np.array([[each.position[:d], each.velocity[:d], each.acceleration[:d]] for each in pieces])
    still = np.zeros((1, 3, d))
    if not pieces:
        still[0, 0] = state.position[:d]
        return BodyMotion(np.zeros(1), still, known=True)
    duration = now * 1e-9 - pieces[-1].begin * 1e-9
    position, velocity, acceleration = path[-1]
    still[0, 0] = position + (velocity + acceleration * duration / 2) * duration
    times = [each.begin * 1e-9 for each in pieces]
    return BodyMotion(read_only([*times, now * 1e-9]), np.concatenate((path, still)), known=True)


def _timeline(
    log_: AgentLog, end: Mapping[str, Any] | None
) -> Iterator[tuple[int, list[float] | None, Setpoint | None]]:
    """Yield instants, ns, each with the recorded state, or else with a setpoint; None in place of both: a crash."""
    crashes = sorted(event["time"] for event in log_.events if event["event"] == "crashed")
    for row, (sensed, acted) in enumerate(zip(_ns(log_.sensed), _ns(log_.acted), strict=True)):
        while crashes and crashes[0] < sensed:
            yield crashes.pop(0), None, None
        yield sensed, log_.state[row].tolist(), None
        position, velocity, acceleration = (part[np.isfinite(part)] for part in np.split(log_.setpoint[row], 3))
        yield acted, None, Setpoint(position, velocity, acceleration if acceleration.size else None)
    if end is not None:
        yield end["time"], end["state"], None


def _ns(seconds: Array) -> list[int]:
    return [round(each * 1e9) for each in seconds.tolist()]
