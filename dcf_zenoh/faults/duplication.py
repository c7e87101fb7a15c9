"""Duplication: messages are delivered twice."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.faults.limits import at_least
from dcf_zenoh.faults.limits import probability as checked
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.spec import nanoseconds


class Duplication(Fault):
    """Each message is delivered a second time with the same probability.

    Args:
        probability: Probability of a second delivery, from 0 to 1.
        delay: Time from the first delivery to the second, in s.

    Raises:
        ValueError: `probability` is not from 0 to 1, or `delay` is negative.
    """

    STAGE = Stage.COPY
    LOSES = False

    def __init__(self, *, probability: float, delay: float = 0.0) -> None:
        self._probability = checked("probability", probability)
        self._delay = nanoseconds(at_least("delay", delay, 0, "s"))

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        """Return the delivery, and perhaps a second one."""
        if rng.random() < self._probability:
            return delivery, delivery._replace(due=delivery.due + self._delay)
        return (delivery,)
