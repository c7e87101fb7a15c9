"""What a central solver would have decided in every step of a run, and how far from it the agents' decisions were.

The solver is OSQP, on the shares of all agents in one place (`dcf_zenoh.problems.central`); it has nothing in common
with the distributed algorithms. The problem of a step is the one that the agents would have posed had each known the
recorded states of all, and its answer the least sum of costs, or the variational equilibrium of a game. Where agents
made detours, they are made here too: the oracle judges what was solved, not where it led.
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
from dcf_zenoh.plugins import is_built_in
from dcf_zenoh.problems.central import solve_together
from dcf_zenoh.problems.share import Share, Shareable
from dcf_zenoh.problems.shared.prediction import state_ahead
from dcf_zenoh.records.agent_log import AgentLog, Integers
from dcf_zenoh.records.run import Run, spread_of


@dataclass(frozen=True)
class Oracle:
    """A run beside the central solution, step by step: K steps, N agents in order of ids. Arrays are read-only.

    Attributes:
        agents: Ids.
        step: Step numbers, shape (K,).
        gap: How far an agent's decision u is from the central one u*: |u - u*|, the Euclidean norm in the units of the
            decision, shape (K, N). NaN where the agent has no decision, or the step no central solution.
        plan_gap: The greatest distance, over the plan's stages, between where the agent's decision and the central one
            would bring its body, m, shape (K, N). NaN as before, and where decisions plan no motion.
        violation: How far the decisions of all, taken together as one vector, are beyond the constraint that they
            violate most: the distance to its half space (to its plane if it is an equation), in the units of the
            decision, so that scaling a constraint changes nothing. 0 if they keep them all, NaN if constraints are not
            linear; shape (K,).
        residual: Of each agent's last round, at which the inner iteration was stopped, shape (K, N).
        unsolved: Step -> why there is no central solution.
    """

    agents: tuple[int, ...]
    step: Integers
    gap: Array
    plan_gap: Array
    violation: Array
    residual: Array
    unsolved: Mapping[int, str]

    def summary(self) -> dict[str, Any]:
        """In single numbers, over all agents and steps; None where there are none."""
        violation = self.violation[np.isfinite(self.violation)]
        return {
            "steps": len(self.step),
            "unsolved": len(self.unsolved),
            "gap": spread_of(self.gap[np.isfinite(self.gap)]),
            "plan_gap": spread_of(self.plan_gap[np.isfinite(self.plan_gap)]),
            "violation": float(violation.max()) if violation.size else None,
            "residual": spread_of(self.residual[np.isfinite(self.residual)]),
        }


STAGES_MAX = 100  # of a plan that are compared


class NoOracle(AlgorithmError):
    """There is no central solution to compare with: the problem cannot be told as arrays."""


def consult(run: Run) -> Oracle:
    """Solve every step of `run` in one place.

    Each agent's problem starts from its recorded state; with `predict_delay` from where the body was predicted to be
    when the setpoint acts. A step in which any agent took no part has no central solution here.

    Args:
        run: Fleet file and plug-ins are taken from its directory.

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
            shares = {i: _share(each) for i, each in posed.items()}
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


def unsolvable(fleet: LoadedFleet) -> str | None:
    """What the central solver says of a fleet whose problem has no solution, which no round of its agents can tell.

    None if there is a solution, or the problem is posed anew in every step, or cannot be told as arrays. Code of others
    is not run.
    """
    spec = fleet.spec
    if spec.controller_kind.kind != "solve_once" or not is_built_in("problems", spec.problem.kind):
        return None
    problems = {i: problem_of(spec, fleet.folder, i) for i in spec.ids}
    try:
        with threadpool_limits(1):
            solve_together({i: _share(problem) for i, problem in problems.items()})
    except NoOracle:
        return None
    except AlgorithmError as error:
        return str(error)
    return None


def _row(log: AgentLog, step: int) -> int | None:
    """Where a log has `step`, if the agent came to a decision in it."""
    rows = np.flatnonzero(log.step == step)
    decided = rows.size and log.stopped_by[rows[-1]] != "abstained" and np.isfinite(log.decision[rows[-1]]).any()
    return int(rows[-1]) if decided else None


def _posed(run: Run, problems: Mapping[int, Any], rows: Mapping[int, int]) -> Mapping[int, Any]:
    """What all agents would solve in one step if each knew the states of all."""
    if not any(hasattr(problem, "at") for problem in problems.values()):
        return problems
    delay = run.fleet.controller_kind.options.get("predict_delay", 0.0)
    states = {i: _ahead(problem, run.agents[i], rows[i], delay) for i, problem in problems.items()}
    return {i: problem.at(states) for i, problem in problems.items()}


def _ahead(problem: Any, log: AgentLog, row: int, delay: float) -> Array:
    """The state from which the agent planned, shape (2 d,)."""
    state = State(*np.split(log.state[row], 2))
    if not delay:
        return state.vector
    flown = _setpoint(log.setpoint[row - 1]) if row else None
    if isinstance(problem, ModelledProblem):
        return problem.ahead(state, flown, delay)
    return state_ahead(state, flown, delay, None)


class _Detours:
    """Where each agent aimed, step by step; see `Detour`.

    Args:
        run: Of its controllers' options.
        problems: Of all agents.
    """

    def __init__(self, run: Run, problems: Mapping[int, Any]) -> None:
        options = run.fleet.controller_kind.options
        aimed = {i: each for i, each in problems.items() if isinstance(each, AimedProblem)}
        self._run, self._delay = run, options.get("predict_delay", 0.0)
        self._problems = aimed if options.get("detour") else {}
        self._known: dict[int, Detour] = {}

    def at(self, step: int) -> dict[int, Array]:
        """Agent -> its aim in `step`; to be asked once for every step, in order."""
        aims = {}
        for i, problem in self._problems.items():
            log = self._run.agents.get(i)
            if log is None or step not in log.step:
                self._known.pop(i, None)  # it was dead, and begins anew
                continue
            detour = self._known.setdefault(i, Detour(problem.target, self._run.fleet.time.sample_time))
            row = int(np.flatnonzero(log.step == step)[-1])
            aims[i] = detour.aim(_ahead(problem, log, row, self._delay))
        return aims


def _toward(problem: Any, aim: Array | None) -> Any:
    return problem if aim is None else problem.toward(aim)


def _setpoint(row: Array) -> Setpoint:
    """A setpoint as it was recorded."""
    position, velocity, acceleration = (part[np.isfinite(part)] for part in np.split(row, 3))
    return Setpoint(position, velocity, acceleration if acceleration.size else None)


def _share(posed: Any) -> Share:
    if not isinstance(posed, Shareable):
        raise NoOracle(f"there is no central solution to compare with: {type(posed).__name__} has no method share()")
    return posed.share()


def _plan_gap(posed: Any, decision: Array, answer: Array) -> float:
    """How far apart two decisions would bring the body, m; NaN if they plan no motion."""
    plan, most, stage = getattr(posed, "setpoint", lambda _decision, _stage: None), np.nan, 0
    while stage < STAGES_MAX and (one := plan(decision, stage)) and (other := plan(answer, stage)):
        most = np.fmax(most, np.linalg.norm(one.position - other.position))
        stage += 1
    return float(most)


def _violation(shares: Mapping[int, Share], decisions: Mapping[int, Array]) -> float:
    """The distance of all decisions, as one vector, to the half space or plane of the constraint violated most."""
    beyond = [np.maximum(each.lower - decisions[i], decisions[i] - each.upper) for i, each in shares.items()]
    coupled = {i: each for i, each in shares.items() if each.b.size}
    if coupled:
        excess = np.sum([each.A @ decisions[i] - each.b for i, each in coupled.items()], axis=0)
        steepness = np.sqrt(np.sum([(each.A**2).sum(axis=1) for each in coupled.values()], axis=0))
        equations = any(each.equality for each in coupled.values())
        beyond.append((abs(excess) if equations else excess)[steepness > 0] / steepness[steepness > 0])
    return max(0.0, *(float(part.max(initial=0.0)) for part in beyond))
