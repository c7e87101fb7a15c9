"""Controller of a fleet without plants."""

from dcf_zenoh.algorithms.algorithm import Algorithm, Dialogue, Me, solve
from dcf_zenoh.controllers.controller import Controller, Decision
from dcf_zenoh.plant import Setpoint, State


class SolveOnce(Controller):
    """Solves the agent's problem once per step; nothing is measured and nothing moves.

    Args:
        problem: Problem, handed to the algorithm unchanged.
        algorithm: Algorithm that solves it.
        me: This agent.
    """

    def __init__(self, problem: object, algorithm: Algorithm, me: Me) -> None:
        self._problem = problem
        self._algorithm = algorithm
        self._me = me

    def control(self, state: State, step: int) -> Dialogue[Decision]:  # noqa: ARG002
        """Run the algorithm on the problem."""
        result = yield from solve(self._algorithm, self._problem, self._me)
        return Decision(Setpoint(), result.decision)

    def next_of_plan(self) -> None:
        """Return None: there is no plan."""
