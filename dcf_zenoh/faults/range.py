"""Range: a radio reaches only agents that are near."""

from collections.abc import Sequence
from math import dist

import numpy as np

from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.faults.limits import at_least
from dcf_zenoh.messaging.delivery import Delivery


class Range(Fault):
    """Messages between agents that are too far from each other are lost.

    Nothing is lost if either agent has no position.

    Args:
        distance: Largest distance at which messages get through, in m, between the position of the sender when it sent
            and the present position of the receiver.

    Raises:
        ValueError: `distance` is negative.

    A message between positions of different dimensions ends the run with a `ConfigurationError`.
    """

    STAGE = Stage.CUT
    NEEDS_POSITIONS = True

    def __init__(self, *, distance: float) -> None:
        self._distance = at_least("distance", distance, 0, "m")

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:  # noqa: ARG002
        """Return the delivery, or nothing beyond the distance."""
        there, here = delivery.message.position, delivery.here
        if not there or not here:
            return (delivery,)
        if len(there) != len(here):
            raise ConfigurationError(
                f"range: the position of agent {delivery.message.sender} has {len(there)} components,"
                f" that of its receiver {len(here)}; there is no distance between them"
            )
        return () if dist(there, here) > self._distance else (delivery,)
