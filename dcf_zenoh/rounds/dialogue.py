"""One dialogue on its way through its rounds: resumed, checked, timed and noted."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar

from dcf_zenoh.algorithms.algorithm import Dialogue, Inbox, PerNeighbour
from dcf_zenoh.errors import AlgorithmError, DcfError, NumericalError, account
from dcf_zenoh.message import Payload

T = TypeVar("T")


class RoundRecord(NamedTuple):
    """One round, as the log keeps it.

    Attributes:
        payload: What the agent sent; of edge payloads, neighbour -> payload.
        residual: The agent's own.
        received_at: Neighbour -> fleet time at which its message of this round was there, ns.
        noted: What the algorithm wanted to show (`Me.note`).
    """

    payload: Mapping[Any, Any]
    residual: float
    received_at: dict[int, int]
    noted: Mapping[str, Any]


class DialogueRun(Generic[T]):
    """Leads one dialogue.

    Args:
        dialogue: An algorithm, or whatever speaks its contract.
        place: Whose it is and of which step, for messages: ``agent 1: step 3``.
        stopwatch: Real time in ns, to measure computation.
        noted: What the algorithm wants to see in the log of a round; None to keep no log of rounds.

    Attributes:
        finished: Whether it has returned.
        rounds: How many payloads it has yielded.
        payload: The last one.
        residual: The last one.
        compute: Real time spent in it, ns.
        last_compute: Real time spent in it since it was resumed last, ns.
        log: One record per round, if those were asked for.
    """

    def __init__(
        self,
        dialogue: Dialogue[T],
        place: str,
        stopwatch: Callable[[], int],
        noted: Callable[[], Mapping[str, Any]] | None,
    ) -> None:
        self._dialogue = dialogue
        self._place = place
        self._stopwatch = stopwatch
        self._noted = noted
        self._heard: tuple[Mapping[Any, Any], float, dict[int, int]] | None = None  # of the round to be logged
        self._result: T
        self.payload: Payload | PerNeighbour = {}
        self.finished = False
        self.rounds = 0
        self.residual = math.inf
        self.compute = 0
        self.last_compute = 0
        self.log: list[RoundRecord] = []

    def resume(self, inbox: Inbox | None) -> bool:
        """Hand over what was heard; whether the dialogue goes on, with its next payload.

        Raises:
            AlgorithmError: The dialogue broke the contract, or raised an exception.
            NumericalError: A residual is not a number.
        """
        began = self._stopwatch()
        said = self._advance(inbox)
        self.last_compute = self._stopwatch() - began
        self.compute += self.last_compute
        if self._noted is not None and self._heard is not None:  # digested now: what was noted belongs to it
            self.log.append(RoundRecord(*self._heard, self._noted()))
        if self.finished:
            return False
        if inbox is not None and inbox.stop:
            raise AlgorithmError(f"{self.place}: the algorithm went on after inbox.stop")
        self._take(said)
        self.rounds += 1
        return True

    @property
    def logs(self) -> bool:
        """Whether it keeps a log of rounds."""
        return self._noted is not None

    def hear(self, own: Mapping[Any, Any], received_at: dict[int, int]) -> None:
        """Note what the inbox that is handed over next answers, for the log."""
        self._heard = own, self.residual, received_at

    @property
    def result(self) -> T:
        """What the dialogue returned."""
        return self._result

    @property
    def place(self) -> str:
        """Where the dialogue is, for messages."""
        return f"{self._place} round {self.rounds}"

    def _advance(self, inbox: Inbox | None) -> Any:
        """What the dialogue says next; whether it has `finished`."""
        try:
            return next(self._dialogue) if inbox is None else self._dialogue.send(inbox)
        except StopIteration as finished:
            self.finished = True
            self._result = finished.value
            return None
        except AlgorithmError as error:
            raise AlgorithmError(f"{self.place}: {error}") from error
        except DcfError:
            raise
        except (Exception, SystemExit) as error:
            raise AlgorithmError(f"{self.place}: {account(error)}") from error

    def _take(self, said: Any) -> None:
        """Take in what the dialogue said: a payload, which is checked when it is sent, and a residual."""
        try:
            self.payload, residual = said
            self.residual = float(residual)
        except (TypeError, ValueError):
            raise AlgorithmError(
                f"{self.place}: the algorithm yielded {said!r:.60}; expected a payload and a residual"
            ) from None
        if self.residual != self.residual:
            raise NumericalError(
                f"{self.place}: the algorithm's residual is not a number; it diverges if a step size is too large"
            )
        if self.residual < 0:
            raise AlgorithmError(f"{self.place}: the algorithm's residual is {self.residual:g}; expected a number >= 0")
