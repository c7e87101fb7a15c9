"""Tampering: a sender sends wrong values."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Stage
from dcf_zenoh.faults.limits import finite
from dcf_zenoh.faults.payload import PayloadFault, with_payload
from dcf_zenoh.message import Payload
from dcf_zenoh.messaging.delivery import Delivery


class Tampering(PayloadFault):
    """The sender sends ``scale * value + offset`` instead of each value, or repeats its first payload (`freeze`).

    A fault of a sender must be on all links from it, as in a rule with ``from`` alone; then all receivers get the same
    wrong values. Scale and offset change real numbers. A frozen payload is repeated whole, with integers and booleans.
    An algorithm may send payloads of different names in different phases: the first payload of each set of names is
    repeated in place of the later ones.

    Args:
        scale: Factor.
        offset: Offset, in the unit of the payload.
        freeze: Repeat the first payload; `scale` and `offset` are applied to it.
        names: Names of the payload entries that are changed; empty: all.

    Raises:
        ValueError: `scale` or `offset` is not finite.
    """

    STAGE = Stage.SENDER

    def __init__(
        self, *, scale: float = 1.0, offset: float = 0.0, freeze: bool = False, names: tuple[str, ...] = ()
    ) -> None:
        super().__init__(names)
        self._scale = finite("scale", scale)
        self._offset = finite("offset", offset)
        self._freeze = freeze
        self._first: dict[frozenset[str], Payload] = {}

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:  # noqa: ARG002
        """Replace the payload."""
        payload = delivery.message.payload
        if self._freeze:
            first = self._first.setdefault(frozenset(payload), payload)
            payload = {name: first[name] if self._concerns(name) else value for name, value in payload.items()}
        payload = self._changed(payload, lambda array: self._scale * array + self._offset)
        return (with_payload(delivery, payload),)
