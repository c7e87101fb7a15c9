"""How well a fleet flew, in single numbers: what `Run` does not tell by itself."""

from itertools import groupby
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from dcf_zenoh.plant import Array
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.run import Run

WHOLE_STEP = 1.5  # sample times; samples further apart than this have a gap between them


class Intrusions(NamedTuple):
    """When some agent was in the safety region of another.

    Attributes:
        number: Of intervals.
        time: Their length together, s.
    """

    number: int
    time: float


def overshoot(run: Run) -> float | None:
    """How far the agents went beyond their targets, m: the greatest of all agents, at the samples; 0 if none did.

    Beyond means along the straight line from start to target, so a detour to the side is none. Agents whose start is
    their target are left out. None: there is no other, or it did not record a step.
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
    """The intervals in which the least barrier value h of all pairs was negative; None without safety regions.

    An interval begins at a sample with h < 0 and ends at the first one after it that is not. What happens in between
    is not known: one that is shorter than a sample time may be missed, and counts as long as one if it is not.
    """
    if not run.barriers.size:
        return None
    inside = run.barriers.min(axis=1) < 0
    number = sum(within for within, _ in groupby(inside.tolist()))
    return Intrusions(number, float(inside.sum()) * run.fleet.time.sample_time)


def tracking_error(run: Run) -> float | None:
    """RMS distance of the bodies from where their plans said that they would be, over all agents and steps, m.

    The setpoint of step k has a position: where the plan's first stage ends, one sample time after the setpoint is
    meant to act, which is t_k, or with `predict_delay` that much later. The body's position at that instant is the
    measured one; where the instant is not that of a sample, a cubic through the positions and velocities of the two
    samples around it tells. If an agent flies the next stage of an earlier plan, then that stage counts. Left out are
    steps in which it was told to hold, and instants after its last sample or in a gap of its log.

    So this is the error of the model in the plan, of the body, of its sensors and of setpoints that act late, all
    together; and it says nothing of whether the plan was a good one. None: there is nothing to compare.
    """
    errors = [_errors(run, log) for log in run.agents.values()]
    every = np.concatenate([each for each in errors if each is not None] or [np.empty(0)])
    return float(np.sqrt(np.mean(every**2))) if every.size else None


def _errors(run: Run, log: AgentLog) -> Array | None:
    """Distance from the planned position, m, of each step that can be compared."""
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
