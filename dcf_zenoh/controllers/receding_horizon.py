"""Model predictive control: share the measured states, solve the game they make, apply its first input."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from dcf_zenoh.algorithms.algorithm import Algorithm, Dialogue, Me, solve
from dcf_zenoh.controllers.controller import Controller, Decision
from dcf_zenoh.controllers.sharing import share_states
from dcf_zenoh.plant import Array, Setpoint, State


class StepProblem(Protocol):
    """What there is to solve in one control step."""

    def setpoint(self, decision: Array, stage: int) -> Setpoint | None:
        """What `decision` plans for the plant, `stage` steps ahead; None beyond its horizon."""


class RecedingHorizonProblem(Protocol):
    """A problem that is posed anew at every step, from the measured states of all agents."""

    def at(self, states: Mapping[int, Array]) -> StepProblem:
        """The step's problem, given agent -> [position, velocity], shape (2d,)."""


class RecedingHorizon(Controller):
    """Receding-horizon control of one agent among others.

    Args:
        problem: Poses the game of each step.
        algorithm: Solves it, in rounds with the neighbours.
        me: This agent.
    """

    def __init__(self, problem: RecedingHorizonProblem, algorithm: Algorithm, me: Me) -> None:
        self._problem = problem
        self._algorithm = algorithm
        self._me = me
        self._posed: StepProblem | None = None
        self._decision: Array = np.empty(0)
        self._stage = 0

    def control(self, state: State) -> Dialogue[Decision]:
        """Share states in as many rounds as the graph's diameter, then solve."""
        states, in_time = yield from share_states(self._me, state.vector)
        if not in_time or len(states) < self._me.count:
            return Decision(None, np.empty(0))
        posed = self._problem.at(states)
        result = yield from solve(self._algorithm, posed, self._me)
        self._posed, self._decision, self._stage = posed, result.decision, 0
        return Decision(posed.setpoint(result.decision, 0), result.decision)

    def next_of_plan(self) -> Setpoint | None:
        """One stage further in the last plan."""
        self._stage += 1
        return None if self._posed is None else self._posed.setpoint(self._decision, self._stage)
