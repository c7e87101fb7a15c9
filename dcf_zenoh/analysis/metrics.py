"""Measures of a run in single numbers, in addition to those of `Run`."""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from dcf_zenoh.plant import Array
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.run import Run

WHOLE_STEP = 1.5  # sample times; samples further apart than this have a gap between them


class Intrusions(NamedTuple):
    """Times in which an agent was in the safety region of another.

    Attributes:
        number: Number of intervals.
        time: Total length, s.
    """

    number: int
    time: float


def overshoot(run: Run) -> float | None:
    """Return the largest distance by which an agent went beyond its target, m, at the samples; 0 if none did.

    It is measured along the straight line from start to target, so a detour to the side does not count. Agents whose
    start is their target are left out. None if there is no other agent with a recorded step.
    """
    found = []
    for agent, target in run.targets.items():
        log, start = run.agents[agent], np.array(run.fleet.agents[agent].start or ())
        size = min(len(start), len(target), log.path.shape[1])
        way = target[:size] - start[:size]
        if len(log.step) and np.any(way):
            beyond = (log.path[:, :size] - target[:size]) @ way / np.linalg.norm(way)
            found.append(max(0.0, float(beyond.max())))
    return max(found, default=None)


def intrusions(run: Run) -> Intrusions | None:
    """Return the intervals in which the least barrier value h of all pairs was negative; None without safety regions.

    They are the `Run.violations` of pairs, joined where they overlap. For bodies whose path between the samples is not
    known an interval begins at a sample with h < 0 and ends at the next one with h >= 0; a shorter one may be missed.
    """
    if not run.barriers.size:
        return None
    joined: list[tuple[float, float]] = []
    for each in (each for each in run.violations if each.quantity == "barrier"):  # in the order of their begin
        if joined and each.since <= joined[-1][1]:
            begin, end = joined.pop()
            joined.append((begin, max(end, each.since + each.duration)))
        else:
            joined.append((each.since, each.since + each.duration))
    return Intrusions(len(joined), sum(end - begin for begin, end in joined))


def tracking_error(run: Run) -> float | None:
    """Return the RMS distance of the bodies from their planned positions, over all agents and steps, m.

    The setpoint of step k has the position at the end of the plan's first stage, one sample time after the setpoint is
    due to act: at t_k, or later by `predict_delay`. The body's position at that instant is the measured one; between
    samples it is interpolated by a cubic through positions and velocities of the two samples around it. If an agent
    flies the next stage of an earlier plan, that stage counts. Steps in which the agent holds are left out, and
    instants after its last sample or in a gap of its log.

    The error has the parts of the model, the body, its sensors and late setpoints. It does not judge the plan. None if
    there is nothing to compare.
    """
    errors = [_errors(run, log) for log in run.agents.values()]
    every = np.concatenate([each for each in errors if each is not None] or [np.empty(0)])
    return float(np.sqrt(np.mean(every**2))) if every.size else None


def _errors(run: Run, log: AgentLog) -> Array | None:
    """Return the distance from the planned position, m, of each step that can be compared."""
    dimensions, width = log.state.shape[1] // 2, log.setpoint.shape[1]
    if width not in (6, 9) or not dimensions or len(log.step) < 2:
        return None
    size = min(dimensions, width // 3)
    time, states = log.sensed, log.state
    if log.end is not None and len(log.end["state"]) == states.shape[1]:
        time, states = np.append(time, log.end["time"] * 1e-9), np.vstack((states, log.end["state"]))
    period = run.fleet.time.sample_time
    after = period + run.fleet.controller_kind.options.get("predict_delay", 0.0)
    due = log.step * period + after
    before = np.searchsorted(time, due - 1e-9, side="left").clip(1, len(time) - 1) - 1
    flown = np.isfinite(log.setpoint[:, 2 * width // 3])
    known = (due <= time[-1] + 1e-9) & (np.diff(time)[before] < WHOLE_STEP * period)
    chosen = flown & known
    position = CubicHermiteSpline(time, states[:, :dimensions], states[:, dimensions:])(due[chosen])
    gaps: Array = np.linalg.norm(position[:, :size] - log.setpoint[chosen, :size], axis=1)
    return gaps
