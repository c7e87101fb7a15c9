"""Check that a prediction horizon is long enough to brake within: the default is right for one sample time only."""

from collections.abc import Collection, Mapping
from math import ceil

import numpy as np

from dcf_zenoh.diagnostics import Diagnostics
from dcf_zenoh.problems.position_swap import PositionSwap
from dcf_zenoh.spec import FleetSpec

LOOK = 10.0  # s of flight in which an agent reaches its highest speed
SHARE = 0.5  # of the time from that speed to rest: among others agents fly about half as fast as alone


def check_braking(
    spec: FleetSpec,
    problems: Mapping[int, object],
    real: Collection[int],
    diagnostics: Diagnostics,
    notes: list[str],
) -> None:
    """Check the horizon of agents that predict their motion; agents with their own problem choose for themselves.

    A plan shows a conflict only within its horizon, so an agent has to be able to brake within it. A horizon that is
    too short is an error if real bodies fly, and a note in simulations.

    Args:
        spec: Specification of the fleet.
        problems: Agent -> its problem.
        real: Agents with real bodies.
        diagnostics: Errors, to which one may be added.
        notes: Remarks, to which one may be added.
    """
    agents = {
        i: problem
        for i, problem in problems.items()
        if isinstance(problem, PositionSwap) and not spec.agents[i].problem
    }
    speeds = {i: _highest_speed(problem, spec.agents[i].start or ()) for i, problem in agents.items()}
    short = [i for i, problem in agents.items() if _seen(problem) < SHARE * speeds[i] / problem.accel_max - 1e-9]
    if not short:
        return
    agent = max(short, key=lambda i: speeds[i])
    problem, speed = agents[agent], speeds[agent]
    needed = SHARE * speed / problem.accel_max
    least = ceil(needed / problem.sample_time - 1e-9)
    text = (
        f"{problem.horizon} samples of {problem.sample_time:g} s are {_seen(problem):.2g} s; agent {agent}, which flies"
        f" up to {speed:.2g} m/s alone and half of that among others, brakes at {problem.accel_max:g} m/s² in"
        f" {needed:.2g} s, and its plans show a conflict too late: expected a horizon of at least {least}"
    )
    if set(short) & set(real):
        diagnostics.add("problem.prediction.horizon", text)
    else:
        notes.append(f"problem.prediction.horizon: {text}")


def _seen(problem: PositionSwap) -> float:
    """Return the time that a plan covers, in s."""
    return problem.horizon * problem.sample_time


def _highest_speed(problem: PositionSwap, start: tuple[float, ...]) -> float:
    """Return the highest speed of an agent that flies from its start to its target alone, in m/s."""
    gain = np.linalg.solve(problem.quadratic, problem.linear)[:2]
    A, B = problem.powers[1], problem.lifts[1][:, :2]
    goal = np.array([*problem.target, 0.0, 0.0])
    state = np.array([*start[:2], 0.0, 0.0]) if len(start) > 1 else goal
    highest = 0.0
    for _ in range(ceil(LOOK / problem.sample_time)):
        state = A @ state - B @ np.clip(gain @ (state - goal), -problem.accel_max, problem.accel_max)
        highest = max(highest, float(np.hypot(*state[2:])))
    return highest
