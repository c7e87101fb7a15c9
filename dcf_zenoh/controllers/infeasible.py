"""What an agent does in a step whose problem has no solution."""

from typing import Literal, Protocol, runtime_checkable

from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plant import Array

FallBack = Literal["least_violation", "previous_plan", "brake", "fail"]


@runtime_checkable
class StartedProblem(Protocol):
    """Problem of one step that knows how the last plan goes on."""

    def start(self, last: Array | None) -> Array:
        """Return the last plan shifted by one stage; without one, no input at all."""


@runtime_checkable
class BrakedProblem(Protocol):
    """Problem of one step whose decisions can bring the body to rest."""

    def brake(self) -> Array:
        """Return the decision that stops the body as fast as its limits allow."""


def fall_back(how: FallBack, posed: object, found: Array, last: Array | None) -> Array:
    """Return the decision to fly in a step without a solution.

    Args:
        how: The key `infeasible` of ``[controller]``.
        posed: Problem of this step.
        found: Decision with the least violation.
        last: Decision of the step before; None in the first.

    Raises:
        AlgorithmError: `how` is "fail", or the problem has no such decision.
    """
    if how == "least_violation":
        return found
    if how == "previous_plan" and last is not None and isinstance(posed, StartedProblem):
        return posed.start(last)
    if (how == "brake" or last is None) and how != "fail" and isinstance(posed, BrakedProblem):
        return posed.brake()
    if how == "fail":
        raise AlgorithmError(
            "the problem of this step is infeasible: its constraints contradict each other (controller.infeasible = "
            '"fail"; "least_violation", "previous_plan" or "brake" go on)'
        )
    method = "start" if how == "previous_plan" else "brake"
    raise AlgorithmError(f'infeasible = "{how}" needs a method {method}, which {type(posed).__name__} has not')
