"""What a controller is: it joins a problem and an algorithm, once per control step."""

from abc import ABC, abstractmethod
from typing import NamedTuple

from dcf_zenoh.algorithms.algorithm import Dialogue
from dcf_zenoh.plant import Array, Setpoint, State


class Decision(NamedTuple):
    """What came of a control step.

    Attributes:
        setpoint: For the plant; None if the step ended before there was one.
        value: The algorithm's decision, shape (n,); empty if there is none.
    """

    setpoint: Setpoint | None
    value: Array


class Controller(ABC):
    """Decides what an agent does in a control step.

    A constructor's positional parameters are filled in by name from `problem`, `algorithm` (its options bound),
    `me` and `sample_time` (s). Its keyword-only parameters are the keys of ``[controller]``.
    """

    @abstractmethod
    def control(self, state: State) -> Dialogue[Decision]:
        """The dialogue of one control step, starting from the measured `state`."""

    @abstractmethod
    def next_of_plan(self) -> Setpoint | None:
        """What the last decision planned for one step later; None if it planned nothing. Each call goes one on."""
