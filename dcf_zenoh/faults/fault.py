"""What a fault is: a small state machine on one directed link."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from dcf_zenoh.messaging.delivery import Delivery


class Stage(IntEnum):
    """Where in a link's chain a fault stands; within a stage the order is that of the names."""

    SENDER = 0  # what the sender does to its payload
    CUT = 1  # whether the link is there at all
    LOSS = 2  # whether the message gets through
    QUEUE = 3  # when it leaves the sender's queue
    DELAY = 4  # how long it travels
    COPY = 5  # how often it comes
    PAYLOAD = 6  # what travelling does to its payload


class FaultLink(NamedTuple):
    """The directed link that a fault is for.

    Attributes:
        sender: Id of the sending agent.
        receiver: Id of the receiving agent.
        folder: Folder that paths of files are relative to: that of the fleet file.
    """

    sender: int
    receiver: int
    folder: Path


class Fault(ABC):
    """One fault on one directed link.

    Each link has an instance of its own, so an instance may keep what it has seen. It is fed in the order in which the
    messages were sent. It knows no clock: `Delivery.entered` is when a message entered the link.

    A constructor's positional parameters are filled in by name: `link`, a `FaultLink`, or any of its fields. Its
    keyword-only parameters are the keys of its table in a fleet file, and a bare value in place of the table, as in
    ``loss = 0.2``, is that of the first.

    Attributes:
        STAGE: Where it stands in the chain.
        LOSES: Whether it can lose messages.
        FILES: Keys that name files, relative to the fleet file; they are copied into the directory of a run.
        AGENTS: Keys that name agents, by their ids or in lists of them.
        NEEDS_POSITIONS: Whether messages must carry their sender's position, and `Delivery.here` the receiver's.
    """

    STAGE: ClassVar[Stage] = Stage.LOSS
    LOSES: ClassVar[bool] = True
    FILES: ClassVar[tuple[str, ...]] = ()
    AGENTS: ClassVar[tuple[str, ...]] = ()
    NEEDS_POSITIONS: ClassVar[bool] = False

    @abstractmethod
    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        """What becomes of one message: nothing is loss, a later `due` is delay, two deliveries are duplication.

        Args:
            delivery: The message, as the fault before in the chain leaves it.
            rng: Random numbers of this message, link and fault alone. Whatever else happened, they are the same.
        """

    @property
    def unmet(self) -> str:
        """What this was to act on and no message had, in words; empty if there is nothing to say."""
        return ""
