"""Numbers that are sent with few digits."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Stage
from dcf_zenoh.faults.limits import positive
from dcf_zenoh.faults.payload import PayloadFault, with_payload
from dcf_zenoh.messaging.delivery import Delivery


class Quantisation(PayloadFault):
    """Every real number of a payload becomes the nearest multiple of a step, so it errs by half a step at most.

    Zero is a multiple (a mid-tread quantiser); a number halfway between two goes to the even one. Messages become
    no shorter. Integers and booleans are not touched.

    Args:
        step: In the unit of the payload.
        names: Of the payload, what is quantised; empty: everything.

    Raises:
        ValueError: `step` is not positive.

    Source: Gersho and Gray (1992), "Vector Quantization and Signal Compression", chapter 5.
    """

    STAGE = Stage.PAYLOAD

    def __init__(self, *, step: float, names: tuple[str, ...] = ()) -> None:
        super().__init__(names)
        self._step = positive("step", step)

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:  # noqa: ARG002
        """Round a copy of the payload."""
        payload = self._changed(delivery.message.payload, lambda array: np.round(array / self._step) * self._step)
        return (with_payload(delivery, payload),)
