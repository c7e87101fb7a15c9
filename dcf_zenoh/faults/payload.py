"""Faults that change payloads, on a copy: other receivers have the same message."""

from collections.abc import Callable
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from dcf_zenoh.faults.fault import Fault
from dcf_zenoh.message import Payload, Value
from dcf_zenoh.messaging.delivery import Delivery

Change = Callable[[npt.NDArray[Any]], npt.NDArray[Any]]


def with_payload(delivery: Delivery, payload: Payload) -> Delivery:
    """Return the same delivery with another payload."""
    return delivery._replace(message=delivery.message._replace(payload=MappingProxyType(payload)))


class PayloadFault(Fault):
    """A fault that changes the real numbers of a payload, or of some of its entries.

    Args:
        names: Names of the payload entries that are changed; empty: all.
    """

    LOSES = False

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = names
        self._missed = dict.fromkeys(names)  # names that no payload has had so far
        self._met: set[str] = set()  # names of all payloads, as long as any name is missed

    def _concerns(self, name: str) -> bool:
        return not self._names or name in self._names

    def _changed(self, payload: Payload, change: Change) -> Payload:
        """Return a payload with `change` applied to its real numbers; integers and booleans do not change.

        Args:
            payload: Payload, which is not modified.
            change: Function from an array of float64 or float32, of any shape, to a new one of that shape. A single
                number is passed as an array of shape (). Overflow gives no warning.
        """
        if self._missed:
            self._met.update(payload)
            self._missed = {name: None for name in self._missed if name not in payload}
        with np.errstate(all="ignore"):
            return {name: _value(value, change) if self._concerns(name) else value for name, value in payload.items()}

    @property
    def unmet(self) -> str:
        """Names that no payload had, such as a misspelt one, and the names that payloads had, or an empty text."""
        if not (self._missed and self._met):
            return ""
        return (
            f"no payload had {', '.join(map(repr, self._missed))}; there were {', '.join(map(repr, sorted(self._met)))}"
        )


def _value(value: Value, change: Change) -> Value:
    if isinstance(value, float):
        return float(change(np.asarray(value)))
    if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
        return value
    array = np.asarray(change(value), dtype=value.dtype)
    array.setflags(write=False)
    return array
