"""A radio that does not reach everybody."""

from collections.abc import Sequence
from math import dist

import numpy as np

from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.faults.limits import at_least
from dcf_zenoh.messaging.delivery import Delivery


class Range(Fault):
    """Messages between agents that are too far from each other are lost.

    Where either agent has no position, nothing is lost.

    Args:
        distance: The largest at which messages get through, in m, from where the sender was when it sent to where the
            receiver is.

    Raises:
        ValueError: `distance` is negative.

    A message between positions of different dimensions ends the run with a `ConfigurationError`.
    """

    STAGE = Stage.CUT
    NEEDS_POSITIONS = True

    def __init__(self, *, distance: float) -> None:
        self._distance = at_least("distance", distance, 0, "m")

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:  # noqa: ARG002
        """Lose it or leave it."""
        there, here = delivery.message.position, delivery.here
        if not there or not here:
            return (delivery,)
        if len(there) != len(here):
            raise ConfigurationError(
                f"range: the position of agent {delivery.message.sender} has {len(there)} components,"
                f" that of its receiver {len(here)}; there is no distance between them"
            )
        return () if dist(there, here) > self._distance else (delivery,)
