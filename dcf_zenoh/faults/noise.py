"""Numbers that arrive not quite as they were sent."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.faults.limits import at_least
from dcf_zenoh.faults.payload import changed, with_payload
from dcf_zenoh.messaging.delivery import Delivery


class Noise(Fault):
    """Gaussian noise of mean 0 on every real number of a payload, independent from one to the next.

    Integers and booleans are not touched.

    Args:
        std: Standard deviation, in the unit of the payload.
        names: Of the payload, what is noisy; empty: everything.

    Raises:
        ValueError: `std` is negative.
    """

    STAGE = Stage.PAYLOAD
    LOSES = False

    def __init__(self, *, std: float, names: tuple[str, ...] = ()) -> None:
        self._std = at_least("std", std, 0)
        self._names = names

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        """Add noise to a copy of the payload."""
        payload = changed(
            delivery.message.payload, self._names, lambda array: array + self._std * rng.standard_normal(array.shape)
        )
        return (with_payload(delivery, payload),)
