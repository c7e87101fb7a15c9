"""A sender that does not say what it should."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Stage
from dcf_zenoh.faults.limits import finite
from dcf_zenoh.faults.payload import PayloadFault, with_payload
from dcf_zenoh.message import Payload
from dcf_zenoh.messaging.delivery import Delivery


class Tampering(PayloadFault):
    """The sender says the same wrong thing to all: ``scale * value + offset``; frozen, a value is what it said first.

    A fault of a sender must be on all links that lead away from it, as a rule with ``from`` alone puts it. Scale and
    offset change real numbers; a frozen payload is repeated whole, integers and booleans too. An algorithm may send
    payloads of different names in different phases: the first payload of each set of names is repeated in its place.

    Args:
        scale: Factor.
        offset: In the unit of the payload.
        freeze: Repeat the first payload; `scale` and `offset` act on that.
        names: Of the payload, what is tampered with; empty: everything.

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
        """Put another payload in place of the true one."""
        payload = delivery.message.payload
        if self._freeze:
            first = self._first.setdefault(frozenset(payload), payload)
            payload = {name: first[name] if self._concerns(name) else value for name, value in payload.items()}
        payload = self._changed(payload, lambda array: self._scale * array + self._offset)
        return (with_payload(delivery, payload),)
