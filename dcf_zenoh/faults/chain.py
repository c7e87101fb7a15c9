"""The faults of one directed link, in a chain."""

import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf
from typing import Any, NamedTuple

import numpy as np

from dcf_zenoh.errors import DcfError, FaultError, account
from dcf_zenoh.faults.fault import Fault
from dcf_zenoh.message import Message
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.requests import NEVER

ALWAYS = (-inf, inf)


class Passage(NamedTuple):
    """Result of leading one message through a chain.

    Attributes:
        deliveries: Deliveries to the receiver.
        lost_by: Name of the fault that lost the message; empty if there is any delivery.
    """

    deliveries: tuple[Delivery, ...]
    lost_by: str


@dataclass
class Layer:
    """The faults of one name in the chain of a link, each with the time in which it acts. Later entries win.

    Attributes:
        name: Name in the fleet file.
        entries: Window [begin, end) of the instants at which messages enter, in ns, and the fault; None: no fault acts.
        place: Number that selects the random numbers of this name.
    """

    name: str
    entries: list[tuple[tuple[float, float], Fault | None]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.place = zlib.crc32(self.name.encode())  # independent of which other faults there are

    def acting(self, instant: int) -> Fault | None:
        """Return the fault that acts on a message that enters at `instant`, ns; None if there is none."""
        for (begin, end), fault in reversed(self.entries):
            if begin <= instant < end:
                return fault
        return None


def _sound(after: object, before: Delivery) -> bool:
    return (
        type(after) is Delivery
        and type(after.due) is int
        and before.entered == after.entered <= after.due <= NEVER
        and type(after.message) is Message
        and after.message[:3] == before.message[:3]  # sender, incarnation, sequence
    )


def _undrawn(philox: np.random.Philox) -> tuple[list[int], Any]:
    """Return the counter of a generator that has drawn nothing, and its state, which holds that counter.

    They hold Python integers instead of numpy arrays: setting such a state takes 0.3 µs instead of 0.7 µs.
    """
    state = philox.state
    counter = [int(word) for word in state["state"]["counter"]]
    key = [int(word) for word in state["state"]["key"]]
    return counter, {**state, "state": {"counter": counter, "key": key}, "buffer": state["buffer"].tolist()}


class FaultChain:
    """The chain of faults of one directed link.

    Args:
        seed: Seed of the fleet.
        sender: Id of the sending agent.
        receiver: Id of the receiving agent.
        layers: Faults by name, in any order.
    """

    def __init__(self, seed: int, sender: int, receiver: int, layers: Iterable[Layer] = ()) -> None:
        key = np.random.SeedSequence([seed, sender, receiver]).generate_state(2, np.uint64)
        self._ends = f"link {sender} -> {receiver}"
        self._philox = np.random.Philox(key=key)
        self._rng = np.random.Generator(self._philox)
        self._counter, self._state = _undrawn(self._philox)
        self._layers = {layer.name: layer for layer in layers}
        self._given = {name: len(layer.entries) for name, layer in self._layers.items()}
        self._order()

    def add(self, name: str, window: tuple[float, float], fault: Fault | None) -> None:
        """Let `fault` act on messages that enter within `window`, in ns, in place of earlier faults of this name."""
        self._layers.setdefault(name, Layer(name)).entries.append((window, fault))
        self._order()

    def clear(self, instant: int) -> None:
        """End all added faults at `instant`, in ns: from then on only the layers given at the beginning act."""
        for layer in self._layers.values():
            for place in range(self._given.get(layer.name, 0), len(layer.entries)):
                (begin, end), fault = layer.entries[place]
                layer.entries[place] = (begin, min(end, instant)), fault

    @property
    def unmet(self) -> list[tuple[str, str]]:
        """Name of each fault that found nothing to act on, and what no message had (`Fault.unmet`)."""
        return [
            (layer.name, fault.unmet)
            for layer in self._chain
            for _, fault in layer.entries
            if fault is not None and fault.unmet
        ]

    def convey(self, delivery: Delivery) -> Passage:
        """Lead one message through the chain; messages must come in the order in which they were sent.

        Raises:
            FaultError: A fault broke its contract.
        """
        deliveries: tuple[Delivery, ...] = (delivery,)
        self._counter[1], self._counter[3] = delivery.message.sequence, delivery.message.incarnation
        for layer in self._chain if self._steady else self._sorted(delivery.entered):
            fault = layer.acting(delivery.entered)
            if fault is None:
                continue
            self._counter[2] = layer.place
            self._philox.state = self._state  # the random numbers of this message and fault
            if len(deliveries) == 1:
                deliveries = self._apply(layer.name, fault, deliveries[0])
            else:
                deliveries = tuple(after for each in deliveries for after in self._apply(layer.name, fault, each))
            if not deliveries:
                return Passage(deliveries, layer.name)
        return Passage(deliveries, "")

    def _apply(self, name: str, fault: Fault, delivery: Delivery) -> tuple[Delivery, ...]:
        """Return the deliveries that `fault` makes of one; raise FaultError if they break its contract."""
        try:
            found = tuple(fault.apply(delivery, self._rng))
        except DcfError:
            raise
        except (Exception, SystemExit) as error:
            raise FaultError(f"{self._ends}: fault {name!r}: {account(error)}") from error
        for after in found:
            if after is not delivery and not _sound(after, delivery):
                raise FaultError(
                    f"{self._ends}: fault {name!r} made {after!r:.60} of a message; expected deliveries of the same"
                    " message, whose due is a whole number of ns, not before they entered"
                )
        return found

    def _order(self) -> None:
        """Sort the chain by stage, then by name; the order is fixed if every name has faults of one stage only."""
        stages = {name: {fault.STAGE for _, fault in each.entries if fault} for name, each in self._layers.items()}
        self._steady = all(len(each) <= 1 for each in stages.values())
        self._chain = sorted(self._layers.values(), key=lambda layer: (min(stages[layer.name], default=0), layer.name))

    def _sorted(self, instant: int) -> list[Layer]:
        """Return the layers that act on a message that enters at `instant`, ns, in their order."""
        found = [(fault.STAGE, layer.name) for layer in self._chain if (fault := layer.acting(instant)) is not None]
        return [self._layers[name] for _, name in sorted(found)]
