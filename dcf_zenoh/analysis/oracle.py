"""Comparison of the agents' decisions with the central solution of every step of a run.

The solver has the shares of all agents in one place (`dcf_zenoh.problems.central`), and is independent of the
distributed algorithms. The problem of a step is the one that the agents would pose if each had the recorded states of
all. Its solution is the least sum of costs, or the variational equilibrium of a game. Detours of agents are repeated
here: the oracle judges the solutions of the problems, not the choice of targets.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from dcf_zenoh.config import LoadedFleet, load
from dcf_zenoh.configuration.building.problem_and_plant import problem_of
from dcf_zenoh.controllers.detour import Detour
from dcf_zenoh.controllers.receding_horizon import AimedProblem, ModelledProblem
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array, Setpoint, State, read_only
from dcf_zenoh.problems.central import solve_together
from dcf_zenoh.problems.share import Share, Shareable
from dcf_zenoh.problems.shared.prediction import state_ahead
from dcf_zenoh.records.agent_log import AgentLog, Integers
from dcf_zenoh.records.run import Run, spread_of


@dataclass(frozen=True)
class Oracle:
    """Comparison of a run with the central solution: K steps, N agents in order of ids. Arrays are read-only.

    Attributes:
        agents: Ids of the agents.
        step: Step numbers, shape (K,).
        gap: Distance |u - u*| of an agent's decision u from the central one u*, the Euclidean norm in the units of the
            decision, shape (K, N). NaN where the agent has no decision, or the step no central solution.
        plan_gap: Greatest distance, over the stages of the plan, between the positions planned by the agent's decision
            and by the central one, m, shape (K, N). NaN as for `gap`, and where decisions plan no motion.
        violation: Distance of the decisions of all, as one vector, from the half space of the constraint that they
            violate most (from the plane of an equation), in the units of the decision; it does not depend on the scale
            of constraints. 0 if all are kept, NaN if constraints are not linear; shape (K,).
        residual: Residual of each agent's last round, shape (K, N).
        unsolved: Step -> reason why there is no central solution.
    """

    agents: tuple[int, ...]
    step: Integers
    gap: Array
    plan_gap: Array
    violation: Array
    residual: Array
    unsolved: Mapping[int, str]

    def summary(self) -> dict[str, Any]:
        """Return single numbers over all agents and steps; None where there are no values."""
        violation = self.violation[np.isfinite(self.violation)]
        return {
            "steps": len(self.step),
            "unsolved": len(self.unsolved),
            "gap": spread_of(self.gap[np.isfinite(self.gap)]),
            "plan_gap": spread_of(self.plan_gap[np.isfinite(self.plan_gap)]),
            "violation": float(violation.max()) if violation.size else None,
            "residual": spread_of(self.residual[np.isfinite(self.residual)]),
        }


STAGES_MAX = 100  # stages of a plan that are compared


class NoOracle(AlgorithmError):
    """Lack of a central solution to compare with: the problem has no method `share`."""


def consult(run: Run) -> Oracle:
    """Solve every step of `run` in one place.

    Each agent's problem starts from its recorded state; with `predict_delay`, from the state predicted for the instant
    at which the setpoint acts. A step in which an agent took no part has no central solution here.

    Args:
        run: The run; fleet file and plug-ins are taken from its directory.

    Raises:
        NoOracle: The problem has no method `share`.
        DcfError: The fleet file or a plug-in cannot be loaded.
    """
    fleet = LoadedFleet(run.fleet, run.home, run.name) if run.folder is None else load(run.folder / "fleet.toml")
    problems = {i: problem_of(fleet.spec, fleet.folder, i) for i in fleet.spec.ids}
    detours = _Detours(run, problems)
    steps = np.unique(np.concatenate([log.step for log in run.agents.values()]))
    shape = len(steps), len(problems)
    gap, plan_gap, residual = (np.full(shape, np.nan) for _ in range(3))
    violation, unsolved = np.full(len(steps), np.nan), dict[int, str]()
    with threadpool_limits(1):
        for row, step in enumerate(steps.tolist()):
            aims = detours.at(step)
            taken = {i: found for i, log in run.agents.items() if (found := _row(log, step)) is not None}
            for column, i in enumerate(problems):
                residual[row, column] = run.agents[i].residual[taken[i]] if i in taken else np.nan
            if absent := [i for i in problems if i not in taken]:
                unsolved[step] = f"took no part: {', '.join(map(str, absent))}"
                continue
            posed = _posed(run, {i: _toward(problem, aims.get(i)) for i, problem in problems.items()}, taken)
            shares = {i: share_of(each) for i, each in posed.items()}
            decisions = {i: run.agents[i].decision[taken[i]][: len(share.g)] for i, share in shares.items()}
            if not any(share.t.size for share in shares.values()):
                violation[row] = _violation(shares, decisions)
            try:
                answers = solve_together(shares)
            except AlgorithmError as error:
                unsolved[step] = str(error)
                continue
            for column, (i, answer) in enumerate(answers.items()):
                gap[row, column] = np.linalg.norm(decisions[i] - answer)
                plan_gap[row, column] = _plan_gap(posed[i], decisions[i], answer)
    return Oracle(
        agents=tuple(problems),
        step=steps,
        gap=read_only(gap),
        plan_gap=read_only(plan_gap),
        violation=read_only(violation),
        residual=read_only(residual),
        unsolved=unsolved,
    )


def _row(log: AgentLog, step: int) -> int | None:
    """Return the row of `step` in a log; None if the agent has no decision in it."""
    rows = np.flatnonzero(log.step == step)
    decided = rows.size and log.stopped_by[rows[-1]] != "abstained" and np.isfinite(log.decision[rows[-1]]).any()
    return int(rows[-1]) if decided else None


def _posed(run: Run, problems: Mapping[int, Any], rows: Mapping[int, int]) -> Mapping[int, Any]:
    """Return the problems of all agents in one step, if each had the states of all."""
    if not any(hasattr(problem, "at") for problem in problems.values()):
        return problems
    delay = run.fleet.controller_kind.options.get("predict_delay", 0.0)
    states = {i: _ahead(problem, run.agents[i], rows[i], delay) for i, problem in problems.items()}
    return {i: problem.at(states) for i, problem in problems.items()}


def _ahead(problem: Any, log: AgentLog, row: int, delay: float) -> Array:
    """Return the state from which the agent planned, shape (2 d,)."""
    state = State(*np.split(log.state[row], 2))
    if not delay:
        return state.vector
    flown = _setpoint(log.setpoint[row - 1]) if row else None
    if isinstance(problem, ModelledProblem):
        return problem.ahead(state, flown, delay)
    return state_ahead(state, flown, delay, None)


class _Detours:
    """Aims of the agents, step by step; see `Detour`.

    Args:
        run: The run.
        problems: Agent -> problem, of all agents.
    """

    def __init__(self, run: Run, problems: Mapping[int, Any]) -> None:
        options = run.fleet.controller_kind.options
        aimed = {i: each for i, each in problems.items() if isinstance(each, AimedProblem)}
        self._run, self._delay = run, options.get("predict_delay", 0.0)
        self._problems = aimed if options.get("detour") else {}
        self._known: dict[int, Detour] = {}

    def at(self, step: int) -> dict[int, Array]:
        """Return agent -> aim in `step`; must be called once for every step, in order."""
        aims = {}
        for i, problem in self._problems.items():
            log = self._run.agents.get(i)
            if log is None or step not in log.step:
                self._known.pop(i, None)  # it was down, and begins again
                continue
            detour = self._known.setdefault(i, Detour(problem.target, self._run.fleet.time.sample_time))
            row = int(np.flatnonzero(log.step == step)[-1])
            aims[i] = detour.aim(_ahead(problem, log, row, self._delay))
        return aims


def _toward(problem: Any, aim: Array | None) -> Any:
    return problem if aim is None else problem.toward(aim)


def _setpoint(row: Array) -> Setpoint:
    """Return a setpoint from its record."""
    position, velocity, acceleration = (part[np.isfinite(part)] for part in np.split(row, 3))
    return Setpoint(position, velocity, acceleration if acceleration.size else None)


def share_of(posed: Any) -> Share:
    """Return the share of a problem; raise `NoOracle` if it has none."""
    if not isinstance(posed, Shareable):
        raise NoOracle(f"there is no central solution to compare with: {type(posed).__name__} has no method share()")
    return posed.share()


def _plan_gap(posed: Any, decision: Array, answer: Array) -> float:
    """Return the greatest distance between the positions that two decisions plan, m; NaN if they plan no motion."""
    plan, most, stage = getattr(posed, "setpoint", lambda _decision, _stage: None), np.nan, 0
    while stage < STAGES_MAX and (one := plan(decision, stage)) and (other := plan(answer, stage)):
        most = np.fmax(most, np.linalg.norm(one.position - other.position))
        stage += 1
    return float(most)


def _violation(shares: Mapping[int, Share], decisions: Mapping[int, Array]) -> float:
    """Return the distance of all decisions, as one vector, from the half space or plane of the most violated one."""
    beyond = [np.maximum(each.lower - decisions[i], decisions[i] - each.upper) for i, each in shares.items()]
    coupled = {i: each for i, each in shares.items() if each.b.size}
    if coupled:
        excess = np.sum([each.A @ decisions[i] - each.b for i, each in coupled.items()], axis=0)
        steepness = np.sqrt(np.sum([(each.A**2).sum(axis=1) for each in coupled.values()], axis=0))
        equations = any(each.equality for each in coupled.values())
        beyond.append((abs(excess) if equations else excess)[steepness > 0] / steepness[steepness > 0])
    return max(0.0, *(float(part.max(initial=0.0)) for part in beyond))
