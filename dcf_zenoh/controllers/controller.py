"""What a controller is: it joins a problem and an algorithm, once per control step."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from dcf_zenoh.algorithms.algorithm import Dialogue
from dcf_zenoh.plant import Array, Setpoint, State

_NONE: Mapping[str, float] = MappingProxyType({})


class Decision(NamedTuple):
    """What came of a control step.

    Attributes:
        setpoint: For the plant; None if the step ended before there was one.
        value: The algorithm's decision, shape (n,); empty if there is none.
        notes: Counts of this step for the log, name -> number.
    """

    setpoint: Setpoint | None
    value: Array
    notes: Mapping[str, float] = _NONE


class Controller(ABC):
    """Decides what an agent does in a control step.

    All that outlives a step is in the controller and in its `Me`, so an agent that returns from a crash gets fresh ones
    of both and goes on in the fleet's present step.

    A constructor's positional parameters are filled in by name from `problem`, `algorithm` (its options bound),
    `me` and `sample_time` (s). Its keyword-only parameters are the keys of ``[controller]``.

    Attributes:
        acts_after: Time from the beginning of the step to the moment for which setpoints are made, s. Earlier ones
            wait until then.
    """

    acts_after: float = 0.0

    @abstractmethod
    def control(self, state: State, step: int) -> Dialogue[Decision]:
        """The dialogue of control step number `step`, starting from the measured `state`."""

    @abstractmethod
    def next_of_plan(self) -> Setpoint | None:
        """What the last decision planned for one step later; None if it planned nothing. Each call goes one on."""
