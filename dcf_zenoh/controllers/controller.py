"""Interface of a controller, which joins a problem and an algorithm once per control step."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from dcf_zenoh.algorithms.algorithm import Dialogue
from dcf_zenoh.plant import Array, Setpoint, State

_NONE: Mapping[str, float] = MappingProxyType({})


class Decision(NamedTuple):
    """Result of a control step.

    Attributes:
        setpoint: Setpoint for the plant; None if the step ended before there was one.
        value: Decision of the algorithm, shape (n,); empty if there is none.
        notes: Counts of this step for the log, name -> number.
    """

    setpoint: Setpoint | None
    value: Array
    notes: Mapping[str, float] = _NONE


class Controller(ABC):
    """Decides what an agent does in a control step.

    All state that outlives a step is in the controller and in its `Me`. An agent that returns from a crash gets a new
    one of each and continues in the fleet's present step.

    The constructor's positional parameters are filled in by name from `problem`, `algorithm` (its options bound),
    `me` and `sample_time` (s). Its keyword-only parameters are the keys of ``[controller]``.

    Attributes:
        acts_after: Time from the beginning of a step to the instant for which its setpoint is made, in s. A setpoint
            that is ready earlier waits until then.
    """

    acts_after: float = 0.0

    @abstractmethod
    def control(self, state: State, step: int) -> Dialogue[Decision]:
        """Return the dialogue of control step number `step`, which starts from the measured `state`."""

    @abstractmethod
    def next_of_plan(self) -> Setpoint | None:
        """Return the setpoint that the last decision planned for the next step; None if there is none.

        Each call moves one step further along the plan.
        """
