"""Noise: real numbers are received with random errors."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Stage
from dcf_zenoh.faults.limits import at_least
from dcf_zenoh.faults.payload import PayloadFault, with_payload
from dcf_zenoh.messaging.delivery import Delivery


class Noise(PayloadFault):
    """Gaussian noise of mean 0 on every real number of a payload, independent for each number.

    Integers and booleans do not change.

    Args:
        std: Standard deviation, in the unit of the payload.
        names: Names of the payload entries that get noise; empty: all.

    Raises:
        ValueError: `std` is negative.
    """

    STAGE = Stage.PAYLOAD

    def __init__(self, *, std: float, names: tuple[str, ...] = ()) -> None:
        super().__init__(names)
        self._std = at_least("std", std, 0)

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        """Add noise to a copy of the payload."""
        payload = self._changed(
            delivery.message.payload, lambda array: array + self._std * rng.standard_normal(array.shape)
        )
        return (with_payload(delivery, payload),)
