"""Changing the payload of a message that others have received too."""

from collections.abc import Callable
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.messaging.message import Payload, Value

Change = Callable[[npt.NDArray[Any]], npt.NDArray[Any]]


def with_payload(delivery: Delivery, payload: Payload) -> Delivery:
    """The same delivery with another payload."""
    return delivery._replace(message=delivery.message._replace(payload=MappingProxyType(payload)))


def changed(payload: Payload, names: tuple[str, ...], change: Change) -> Payload:
    """A payload whose real numbers went through `change`; integers and booleans are as they were.

    Args:
        payload: It stays what it is.
        names: What is changed of it, as far as it is there; empty: everything.
        change: Gets an array of any shape, of float64 or float32, and returns a new one of that shape. A number goes
            through it as an array of shape (). Overflow is not warned of.
    """
    with np.errstate(all="ignore"):
        return {name: _value(value, change) if not names or name in names else value for name, value in payload.items()}


def _value(value: Value, change: Change) -> Value:
    if isinstance(value, float):
        return float(change(np.asarray(value)))
    if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
        return value
    array = np.asarray(change(value), dtype=value.dtype)
    array.setflags(write=False)
    return array
