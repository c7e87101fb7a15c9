"""Model predictive control: share the measured states, solve the problem of this step, apply its first input."""

from collections.abc import Collection, Mapping
from typing import ClassVar, Literal, Protocol, cast, runtime_checkable

import numpy as np

from dcf_zenoh.algorithms.algorithm import Algorithm, Dialogue, Me, solve
from dcf_zenoh.controllers.controller import Controller, Decision
from dcf_zenoh.controllers.detour import Detour
from dcf_zenoh.controllers.fleet_states import FleetStates, HasSigns, Signs
from dcf_zenoh.controllers.flooding import share_states
from dcf_zenoh.controllers.infeasible import FallBack, fall_back
from dcf_zenoh.plant import Array, Setpoint, State, read_only
from dcf_zenoh.problems.shared.prediction import state_ahead


class StepProblem(Protocol):
    """Problem of one control step."""

    def setpoint(self, decision: Array, stage: int) -> Setpoint | None:
        """Return the setpoint that `decision` plans for `stage` steps ahead; None beyond its horizon."""


class RecedingHorizonProblem(Protocol):
    """Problem that is posed anew in every step, from the states of all agents.

    A problem that also has a method `signs` is used as a `SignedProblem`. A problem whose attribute `local` is true
    gets the state of its own agent alone, and no states are shared.
    """

    def at(self, states: Mapping[int, Array]) -> StepProblem:
        """Return the problem of this step, given agent -> [position, velocity], shape (2 d,)."""


class SignedProblem(HasSigns, Protocol):
    """Problem in which the agents of a pair must make the same choice, and which handles lost agents itself.

    Any other problem gets the last position of a lost agent as its state, with zero velocity.
    """

    def at(self, states: Mapping[int, Array], *, signs: Signs, lost: Collection[int]) -> StepProblem:
        """Return the problem of this step.

        Args:
            states: Agent -> [position, velocity], shape (2 d,).
            signs: Pair -> choice; a pair that is not in it uses the choice that `states` imply.
            lost: Agents that take no part in solving it.
        """


@runtime_checkable
class ModelledProblem(Protocol):
    """Problem with a model of its body's motion. Without one, a body is assumed to hold its acceleration."""

    def ahead(self, state: State, flown: Setpoint | None, delay: float) -> Array:
        """Return [position, velocity] after `delay` (s) under the setpoint in force, if any; shape (2 d,)."""


@runtime_checkable
class AimedProblem(Protocol):
    """Problem with a target in the plane that can be replaced.

    Attributes:
        target: Target, shape (2,), in m.
    """

    target: Array

    def toward(self, target: Array) -> RecedingHorizonProblem | SignedProblem:
        """Return the same problem with another target, shape (2,), in m."""


class RecedingHorizon(Controller):
    """Receding-horizon control of one agent of a fleet.

    Args:
        problem: Poses the problem of each step.
        algorithm: Algorithm that solves it, in rounds with the neighbours.
        me: This agent.
        sample_time: t_s, in s.
        sharing: How the agents share their states, unless the problem is local. "flood": in as many rounds as the
            graph's diameter; if a message of these is lost, there may be no setpoint. "piggyback": on every message of
            every round; a state that is missing is predicted at constant velocity from the newest one received.
        predict_delay: Time from the measurement until the setpoint acts, in s. The problem starts from the agent's
            state predicted for that instant, under the setpoint in force.
        lost_after: With "piggyback", an agent whose newest state is older than this, in s, takes no part; the others
            keep clear of its last position.
        infeasible: What to fly in a step in which the algorithm finds that the problem, or the agent's part of it, has
            no solution. "least_violation": the decision that violates the shared constraints least; "previous_plan":
            the last plan, one stage further, or "brake" if there is none; "brake": a stop as fast as the limits allow;
            "fail": the run ends. The note ``infeasible`` counts these steps. Methods of prices, such as `trades`, do
            not find it out: they end such a step out of rounds, with bounded prices.
        detour: An agent that is stuck turns its target aside for a while; see `Detour`. Its note ``detours`` counts
            these.

    Raises:
        ValueError: A time is negative, or `detour` is set and the problem has no target.
    """

    RENAMED_VALUES: ClassVar[Mapping[str, Mapping[str, str]]] = {"sharing": {"ride": "piggyback"}}

    def __init__(
        self,
        problem: RecedingHorizonProblem | SignedProblem,
        algorithm: Algorithm,
        me: Me,
        sample_time: float,
        *,
        sharing: Literal["flood", "piggyback"] = "flood",
        predict_delay: float = 0.0,
        lost_after: float = 0.6,
        infeasible: FallBack = "least_violation",
        detour: bool = False,
    ) -> None:
        for name, value in (("predict_delay", predict_delay), ("lost_after", lost_after)):
            if not value >= 0:
                raise ValueError(f"{name} must be a time >= 0, in s, not {value}")
        if detour and not isinstance(problem, AimedProblem):
            raise ValueError(f"detour needs a problem with a target, which {type(problem).__name__} has not")
        self._problem = problem
        self._detour = Detour(problem.target, sample_time) if detour and isinstance(problem, AimedProblem) else None
        self._algorithm = algorithm
        self._me = me
        self._infeasible: FallBack = infeasible
        me.tolerant = True
        self._predict_delay = self.acts_after = predict_delay
        self._local = bool(getattr(problem, "local", False))
        self._fleet_states = (
            FleetStates(me, problem, sample_time, lost_after) if sharing == "piggyback" and not self._local else None
        )
        self._posed: StepProblem | None = None
        self._decision: Array = np.empty(0)
        self._stage = 0
        self._flown: Setpoint | None = None

    def control(self, state: State, step: int) -> Dialogue[Decision]:
        """Share states, then solve the problem that they pose."""
        own = self._ahead(state)
        self._flown = None
        problem, begun = self._problem, 0
        if self._detour is not None and isinstance(problem, AimedProblem):
            begun = self._detour.begun
            problem = problem.toward(self._detour.aim(own))
        if self._local:
            decision = yield from self._solve(problem, {self._me.id: own})
        elif self._fleet_states is None:
            decision = yield from self._flood(problem, own)
        else:
            decision = yield from self._piggyback(problem, self._fleet_states, own, step)
        if self._detour is None:
            return decision
        return decision._replace(notes={**decision.notes, "detours": self._detour.begun - begun})

    def next_of_plan(self) -> Setpoint | None:
        """Return the setpoint one stage further in the last plan; None beyond its end or if there is no plan."""
        self._stage += 1
        self._flown = None if self._posed is None else self._posed.setpoint(self._decision, self._stage)
        return self._flown

    def _flood(self, problem: RecedingHorizonProblem | SignedProblem, own: Array) -> Dialogue[Decision]:
        states, in_time = yield from share_states(self._me, own)
        if not in_time or len(states) < self._me.count:
            return Decision(None, np.empty(0), {"unknown_agents": self._me.count - len(states)})
        return (yield from self._solve(problem, states))

    def _solve(
        self, problem: RecedingHorizonProblem | SignedProblem, states: Mapping[int, Array]
    ) -> Dialogue[Decision]:
        posed = cast(RecedingHorizonProblem, problem).at(states)
        last, self._me.violated = self._me.last, False
        result = yield from solve(self._algorithm, posed, self._me)
        return self._plan(posed, result.decision, last, {})

    def _piggyback(
        self, problem: RecedingHorizonProblem | SignedProblem, fleet_states: FleetStates, own: Array, step: int
    ) -> Dialogue[Decision]:
        view = yield from fleet_states.share(own, step)
        if view is None:
            return Decision(None, np.empty(0), {"unknown_agents": len(fleet_states.unknown)})
        if isinstance(problem, HasSigns):
            posed = problem.at(view.states, signs=view.signs, lost=view.lost)
        else:
            posed = problem.at(view.states)
        last, self._me.violated = self._me.last, False
        result = yield from fleet_states.piggyback.wrap(solve(self._algorithm, posed, self._me))
        notes = {
            "predicted": view.predicted,
            "lost_agents": len(view.lost),
            "sign_disagreements": fleet_states.disagreements(view, step),
        }
        return self._plan(posed, result.decision, last, notes)

    def _plan(self, posed: StepProblem, decision: Array, last: Array | None, notes: Mapping[str, float]) -> Decision:
        """Keep the plan, or what replaces it in a step without a solution, and return its first stage."""
        if self._me.violated:
            decision = self._me.last = read_only(fall_back(self._infeasible, posed, decision, last))
            notes = {**notes, "infeasible": 1}
        self._posed, self._decision, self._stage = posed, decision, 0
        self._flown = posed.setpoint(decision, 0)
        return Decision(self._flown, decision, notes)

    def _ahead(self, state: State) -> Array:
        """Return [position, velocity] at the instant at which the setpoint acts.

        Without a setpoint in force the body is assumed to keep its velocity.
        """
        delay = self._predict_delay
        if not delay:
            return state.vector
        if isinstance(self._problem, ModelledProblem):
            return self._problem.ahead(state, self._flown, delay)
        return state_ahead(state, self._flown, delay, None)
