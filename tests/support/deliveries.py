"""Messages for the tests of faults: streams of them over one link."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from dcf_zenoh.faults.chain import ALWAYS, FaultChain, Layer, Passage
from dcf_zenoh.faults.fault import Fault
from dcf_zenoh.message import Last, Message, Payload, canonical
from dcf_zenoh.messaging.delivery import Delivery

MANY = 100_000
MS = 1_000_000  # ns
S = 1_000_000_000
HERE = Path()
CONFIDENCE = 0.999
Z = float(stats.norm.ppf((1 + CONFIDENCE) / 2))  # a normal variable is within Z standard deviations as often
PAYLOAD: Payload = canonical({"x": np.array([0.1, -2.0, 3.3]), "n": 2})


def delivery(sequence: int = 0, entered: int = 0, payload: dict[str, Any] | None = None, **fields: Any) -> Delivery:
    """A message of agent 1 that has just entered a link."""
    here = fields.pop("here", ())
    own = PAYLOAD if payload is None else canonical(payload)
    message = Message(1, 0, sequence, 0, 0, entered, -1, -1, 0, Last.NO, (), (), own)._replace(**fields)
    return Delivery(message, entered, entered, here)


def padded(padding: int, entered: int = 0) -> Delivery:
    """A message with so many bytes of payload."""
    return delivery(0, entered, {"x": np.zeros(padding, "u1")})


def link(key: tuple[int, int, int] = (0, 1, 2), /, **faults: Fault) -> FaultChain:
    """A link with faults by name, at all times; its key is seed, sender and receiver."""
    return FaultChain(*key, [Layer(name, [(ALWAYS, fault)]) for name, fault in faults.items()])


def convey(over: FaultChain, count: int = MANY, interval: int = MS) -> list[Passage]:
    """What becomes of so many messages, one each `interval`, in ns."""
    first = delivery()
    passages = []
    for number in range(count):
        at = number * interval
        passages.append(over.convey(Delivery(first.message._replace(sequence=number), at, at)))
    return passages


def lost(passages: list[Passage]) -> list[bool]:
    """Which messages were lost."""
    return [not passage.deliveries for passage in passages]


def latencies(passages: list[Passage]) -> list[float]:
    """From entering to being due, in s, of what came."""
    return [(each.due - each.entered) * 1e-9 for passage in passages for each in passage.deliveries]


def alone(fault: Fault, given: Delivery, seed: int = 0) -> list[Delivery]:
    """What one fault makes of one message."""
    return list(fault.apply(given, np.random.Generator(np.random.Philox(seed))))
