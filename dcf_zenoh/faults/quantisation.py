"""Quantisation: real numbers are received rounded."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Stage
from dcf_zenoh.faults.limits import positive
from dcf_zenoh.faults.payload import PayloadFault, with_payload
from dcf_zenoh.messaging.delivery import Delivery


class Quantisation(PayloadFault):
    """Every real number of a payload is rounded to the nearest multiple of a step; the error is at most half a step.

    Zero is a multiple (a mid-tread quantiser). A number halfway between two multiples is rounded to the even one.
    Messages do not become shorter. Integers and booleans do not change.

    Args:
        step: Distance between two multiples, in the unit of the payload.
        names: Names of the payload entries that are quantised; empty: all.

    Raises:
        ValueError: `step` is not positive.

    Source: Gersho and Gray (1992), "Vector Quantization and Signal Compression", chapter 5.
    """

    STAGE = Stage.PAYLOAD

    def __init__(self, *, step: float, names: tuple[str, ...] = ()) -> None:
        super().__init__(names)
        self._step = positive("step", step)

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:  # noqa: ARG002
        """Round the numbers of a copy of the payload."""
        payload = self._changed(delivery.message.payload, lambda array: np.round(array / self._step) * self._step)
        return (with_payload(delivery, payload),)
