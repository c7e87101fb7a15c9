"""Contract check for faults of links."""

from collections.abc import Callable, Iterator
from copy import deepcopy

import numpy as np

from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.message import Last, Message, Payload, canonical
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.testing.equality import same_payload


def check_fault(make: Callable[[], Fault], *, messages: int = 200) -> None:
    """Check the contract of a fault on a link.

    Equal messages and random numbers give equal deliveries, independent of other instances of the fault. The fault
    keeps no generator beyond the message that it got it for. Each delivery is due at a whole number of ns, not before
    the message entered, and its payload can be sent. The fault does not modify the payload that it got, which other
    receivers share.

    Args:
        make: Makes a new fault of one link, the same each time.
        messages: Number of messages to try.

    Raises:
        AssertionError: The fault breaks the contract; the message states how.
    """
    fault, again, elsewhere = make(), make(), make()
    assert isinstance(fault.STAGE, Stage), f"STAGE is {fault.STAGE!r}, expected a member of Stage"
    shared = np.random.Generator(np.random.Philox(0))  # as on a link: one generator, seeded anew for each message
    for number, delivery in enumerate(_deliveries(messages)):
        place = f"message {number}"
        before = deepcopy(dict(delivery.message.payload))
        outcome = list(fault.apply(delivery, np.random.Generator(np.random.Philox(number))))
        elsewhere.apply(delivery, np.random.Generator(np.random.Philox(messages + number)))
        shared.bit_generator.state = np.random.Philox(number).state
        repeated = list(again.apply(delivery, shared))
        assert same_payload(before, delivery.message.payload), f"{place}: it changed the payload that it got"
        assert outcome or fault.LOSES, f"{place}: it lost it, although LOSES is False"
        for each in outcome:
            _check_conveyed(each, delivery, place)
        assert len(outcome) == len(repeated), f"{place}: it is not repeatable"
        for one, other in zip(outcome, repeated, strict=True):
            same = one[1:] == other[1:] and same_payload(one.message.payload, other.message.payload)
            assert same, f"{place}: it is not repeatable"


def _check_conveyed(conveyed: Delivery, delivery: Delivery, place: str) -> None:
    """Check one of the deliveries that the fault returned for `delivery`."""
    assert isinstance(conveyed, Delivery), f"{place}: it returned {conveyed!r:.60}; expected deliveries"
    due = conveyed.due
    assert type(due) is int, f"{place}: due at {due!r}, expected a whole number of ns"
    assert due >= delivery.entered, f"{place}: due at {due} ns, before it entered at {delivery.entered} ns"
    assert conveyed.entered == delivery.entered, f"{place}: it changed when the message entered"
    assert conveyed.here == delivery.here, f"{place}: it changed where the receiver is"
    canonical(conveyed.message.payload)
    for name, value in conveyed.message.payload.items():
        locked = not isinstance(value, np.ndarray) or not value.flags.writeable
        assert locked, f"{place}: its payload {name!r} can be changed"


def _deliveries(count: int) -> Iterator[Delivery]:
    """Yield varied messages from agent 1 to agent 2: two kinds of payload and an empty one, with pauses and bursts."""
    rng = np.random.default_rng(0)
    entered = 0
    for number in range(count):
        entered += int(rng.choice([0, 1, 1_000_000, 50_000_000]))
        phases: tuple[Payload, ...] = (
            {"x": rng.normal(size=3), "free": rng.random(4) < 0.5, "count": number},
            {"gain": rng.normal(), "map": rng.normal(size=(2, 5)).astype("f4"), "ids": np.arange(number % 7)},
            {},
        )
        payload = canonical(phases[number % 2 if number % 10 else 2])
        there, here = (tuple(rng.uniform(-3, 3, 2).tolist()) if number % 5 else () for _ in range(2))
        message = Message(1, 0, number, number // 4, number % 4, entered, -1, -1, 0, Last.NO, (1.0,), there, payload)
        yield Delivery(message, entered, entered + int(rng.choice([0, 5_000_000])), here)
