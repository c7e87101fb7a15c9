"""The interface of a fault: a small state machine on one directed link."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from dcf_zenoh.messaging.delivery import Delivery


class Stage(IntEnum):
    """Position of a fault in the chain of its link; faults of one stage are sorted by name."""

    SENDER = 0  # the sender changes its payload
    CUT = 1  # the link is interrupted
    LOSS = 2  # the message is lost
    QUEUE = 3  # the message waits in the sender's queue
    DELAY = 4  # the message takes time on the way
    COPY = 5  # the message is delivered several times
    PAYLOAD = 6  # the payload changes on the way


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

    Each link has its own instance, so an instance may keep a state. It gets the messages in the order of sending. It
    has no clock: `Delivery.entered` is the instant at which a message entered the link.

    A constructor's positional parameters are filled in by name: `link`, a `FaultLink`, or any of its fields. Its
    keyword-only parameters are the keys of its table in a fleet file, and a bare value in place of the table, as in
    ``loss = 0.2``, is that of the first.

    Attributes:
        STAGE: Position in the chain.
        LOSES: Whether the fault can lose messages.
        FILES: Keys that name files, relative to the fleet file; the files are copied into the directory of a run.
        AGENTS: Keys whose values are ids of agents, or lists of them.
        NEEDS_POSITIONS: Whether messages must carry the position of their sender, and `Delivery.here` that of the
            receiver.
    """

    STAGE: ClassVar[Stage] = Stage.LOSS
    LOSES: ClassVar[bool] = True
    FILES: ClassVar[tuple[str, ...]] = ()
    AGENTS: ClassVar[tuple[str, ...]] = ()
    NEEDS_POSITIONS: ClassVar[bool] = False

    @abstractmethod
    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        """Return what the fault makes of one message.

        No delivery is loss, a later `due` is delay, two deliveries are duplication.

        Args:
            delivery: The message, as the previous fault of the chain left it.
            rng: Random numbers for this message, link and fault. They do not depend on other messages or faults.
        """

    @property
    def least_delay(self) -> float:
        """Shortest time by which the fault delays a message, s; 0 if unknown. Checks ask built-in faults alone."""
        return 0.0

    @property
    def usual_delay(self) -> float:
        """Typical time by which the fault delays a message, s; 0 if unknown. Checks ask built-in faults alone."""
        return 0.0

    @property
    def unmet(self) -> str:
        """Description of what the fault should act on and no message had; empty if there is nothing to report."""
        return ""
