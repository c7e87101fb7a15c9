"""Model predictive control: share the measured states, solve the game they make, apply its first input."""

from collections.abc import Collection, Mapping
from typing import Literal, Protocol, cast, runtime_checkable

import numpy as np

from dcf_zenoh.algorithms.algorithm import Algorithm, Dialogue, Me, solve
from dcf_zenoh.controllers.controller import Controller, Decision
from dcf_zenoh.controllers.detour import Detour
from dcf_zenoh.controllers.fleet_states import FleetStates, Signed, Signs
from dcf_zenoh.controllers.flooding import share_states
from dcf_zenoh.plant import Array, Setpoint, State
from dcf_zenoh.problems.shared.prediction import state_ahead


class StepProblem(Protocol):
    """What there is to solve in one control step."""

    def setpoint(self, decision: Array, stage: int) -> Setpoint | None:
        """What `decision` plans for the plant, `stage` steps ahead; None beyond its horizon."""


class RecedingHorizonProblem(Protocol):
    """A problem that is posed anew at every step, from the states of all agents.

    If it has a method `signs` too, it is taken to be a `SignedProblem`; if it has an attribute `local` that is true, it
    gets the own state alone, and no state is shared.
    """

    def at(self, states: Mapping[int, Array]) -> StepProblem:
        """The step's problem, given agent -> [position, velocity], shape (2d,)."""


class SignedProblem(Signed, Protocol):
    """A problem in which pairs of agents must choose alike, and which knows what to do about agents that are lost.

    Any other problem is told the last position of a lost agent as its state, and rest as its velocity.
    """

    def at(self, states: Mapping[int, Array], *, signs: Signs, lost: Collection[int]) -> StepProblem:
        """The step's problem.

        Args:
            states: Agent -> [position, velocity], shape (2d,).
            signs: What the pairs have chosen; for a pair that is not there, what `states` ask for.
            lost: Agents that take no part in solving it.
        """


@runtime_checkable
class ModelledProblem(Protocol):
    """A problem that knows how its body moves. The body of any other is taken to hold its acceleration."""

    def ahead(self, state: State, flown: Setpoint | None, delay: float) -> Array:
        """Position and velocity after `delay` (s) with the setpoint that is being flown, if any; shape (2 d,)."""


@runtime_checkable
class AimedProblem(Protocol):
    """A problem with a target in the plane, which can be turned to another."""

    target: Array

    def toward(self, target: Array) -> RecedingHorizonProblem | SignedProblem:
        """The same problem with another target, shape (2,), in m."""


class RecedingHorizon(Controller):
    """Receding-horizon control of one agent among others.

    Args:
        problem: Poses the game of each step.
        algorithm: Solves it, in rounds with the neighbours.
        me: This agent.
        sample_time: t_s, in s.
        sharing: How the agents learn of each other's states, where the problem is not local. "flood": in as many rounds
            as the graph's diameter, in which nothing may be lost, or there is no setpoint. "ride": on every message of
            every round; a state that did not come in time is predicted, at constant velocity, from the newest one that
            did.
        predict_delay: Time from the measurement until the setpoint acts, in s. The problem starts from the own
            state predicted for then, under the setpoint that is being flown.
        lost_after: With "ride", an agent whose newest state is older than this, in s, is kept clear of where it
            was last and takes no part.
        detour: An agent that is stuck turns its target aside for a while; see `Detour`. Its note ``detours`` counts
            how often.

    Raises:
        ValueError: A time is negative, or there is no target to be turned.
    """

    def __init__(
        self,
        problem: RecedingHorizonProblem | SignedProblem,
        algorithm: Algorithm,
        me: Me,
        sample_time: float,
        *,
        sharing: Literal["flood", "ride"] = "flood",
        predict_delay: float = 0.0,
        lost_after: float = 0.6,
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
        self._predict_delay = self.acts_after = predict_delay
        self._local = bool(getattr(problem, "local", False))
        self._others = (
            FleetStates(me, problem, sample_time, lost_after) if sharing == "ride" and not self._local else None
        )
        self._posed: StepProblem | None = None
        self._decision: Array = np.empty(0)
        self._stage = 0
        self._flown: Setpoint | None = None

    def control(self, state: State, step: int) -> Dialogue[Decision]:
        """Share states, then solve."""
        own = self._ahead(state)
        self._flown = None
        problem, begun = self._problem, 0
        if self._detour is not None and isinstance(problem, AimedProblem):
            begun = self._detour.begun
            problem = problem.toward(self._detour.aim(own))
        if self._local:
            decision = yield from self._solve(problem, {self._me.id: own})
        elif self._others is None:
            decision = yield from self._flood(problem, own)
        else:
            decision = yield from self._ride(problem, self._others, own, step)
        if self._detour is None:
            return decision
        return decision._replace(notes={**decision.notes, "detours": self._detour.begun - begun})

    def next_of_plan(self) -> Setpoint | None:
        """One stage further in the last plan."""
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
        result = yield from solve(self._algorithm, posed, self._me)
        return self._plan(posed, result.decision, {})

    def _ride(
        self, problem: RecedingHorizonProblem | SignedProblem, others: FleetStates, own: Array, step: int
    ) -> Dialogue[Decision]:
        sight = yield from others.meet(own, step)
        if sight is None:
            return Decision(None, np.empty(0), {"unknown_agents": len(others.unknown)})
        if isinstance(problem, Signed):
            posed = problem.at(sight.states, signs=sight.signs, lost=sight.lost)
        else:
            posed = problem.at(sight.states)
        result = yield from others.carrier.carry(solve(self._algorithm, posed, self._me))
        notes = {
            "predicted": sight.predicted,
            "lost_agents": len(sight.lost),
            "sign_disagreements": others.disagreements(sight, step),
        }
        return self._plan(posed, result.decision, notes)

    def _plan(self, posed: StepProblem, decision: Array, notes: Mapping[str, float]) -> Decision:
        """Keep the plan, and decide on its first stage."""
        self._posed, self._decision, self._stage = posed, decision, 0
        self._flown = posed.setpoint(decision, 0)
        return Decision(self._flown, decision, notes)

    def _ahead(self, state: State) -> Array:
        """Where the body will be when the setpoint acts; without a setpoint being flown, at constant velocity."""
        delay = self._predict_delay
        if not delay:
            return state.vector
        if isinstance(self._problem, ModelledProblem):
            return self._problem.ahead(state, self._flown, delay)
        return state_ahead(state, self._flown, delay, None)
