"""Messages that get lost, each on its own."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.faults.limits import probability as checked
from dcf_zenoh.messaging.delivery import Delivery


class Loss(Fault):
    """Every message is lost with the same probability, whatever became of the others.

    Args:
        probability: Of losing a message, from 0 to 1.

    Raises:
        ValueError: `probability` is not from 0 to 1.
    """

    STAGE = Stage.LOSS

    def __init__(self, *, probability: float) -> None:
        self._probability = checked("probability", probability)

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        """Lose it or leave it."""
        return () if rng.random() < self._probability else (delivery,)
