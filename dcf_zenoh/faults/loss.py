"""Loss: messages are lost independently of each other."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.faults.limits import probability as checked
from dcf_zenoh.messaging.delivery import Delivery


class Loss(Fault):
    """Every message is lost with the same probability, independently of the other messages.

    Args:
        probability: Probability of losing a message, from 0 to 1.

    Raises:
        ValueError: `probability` is not from 0 to 1.
    """

    STAGE = Stage.LOSS

    def __init__(self, *, probability: float) -> None:
        self._probability = checked("probability", probability)

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        """Return the delivery, or nothing."""
        return () if rng.random() < self._probability else (delivery,)
