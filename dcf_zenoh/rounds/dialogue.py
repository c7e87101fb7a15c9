"""Run of one dialogue through its rounds: resumed, checked, timed and logged."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar

from dcf_zenoh.algorithms.algorithm import Dialogue, Inbox, PerNeighbour
from dcf_zenoh.errors import AlgorithmError, DcfError, NumericalError, account
from dcf_zenoh.message import Payload

T = TypeVar("T")


class RoundRecord(NamedTuple):
    """Log entry of one round.

    Attributes:
        payload: Payload that the agent sent; of edge payloads, neighbour -> payload.
        residual: The agent's own residual.
        received_at: Neighbour -> fleet time at which its message of this round was received, ns.
        noted: Values that the algorithm noted (`Me.note`).
    """

    payload: Mapping[Any, Any]
    residual: float
    received_at: dict[int, int]
    noted: Mapping[str, Any]


class DialogueRun(Generic[T]):
    """Run of one dialogue.

    Args:
        dialogue: An algorithm, or another generator with its contract.
        place: Agent and step, for error texts: ``agent 1: step 3``.
        stopwatch: Clock in real ns, to measure computation.
        noted: Returns what the algorithm notes for the log of a round; None: no log of rounds.

    Attributes:
        place: Agent and step.
        finished: Whether the dialogue has returned.
        rounds: Number of payloads yielded so far.
        payload: The last payload.
        residual: The last residual.
        compute: Real time spent in the dialogue, ns.
        last_compute: Real time spent in the dialogue since it was last resumed, ns.
        log: One record per round; empty without a log of rounds.
    """

    def __init__(
        self,
        dialogue: Dialogue[T],
        place: str,
        stopwatch: Callable[[], int],
        noted: Callable[[], Mapping[str, Any]] | None,
    ) -> None:
        self._dialogue = dialogue
        self._stopwatch = stopwatch
        self._noted = noted
        self._unfinished_record: tuple[Mapping[Any, Any], float, dict[int, int]] | None = None
        self._result: T
        self.place = place
        self.payload: Payload | PerNeighbour = {}
        self.finished = False
        self.rounds = 0
        self.residual = math.inf
        self.compute = 0
        self.last_compute = 0
        self.log: list[RoundRecord] = []

    def resume(self, inbox: Inbox | None) -> bool:
        """Resume the dialogue with the inbox of its last round; return whether it has yielded another payload.

        Raises:
            AlgorithmError: The dialogue broke the contract, or raised an exception.
            NumericalError: A residual is not a number.
        """
        began = self._stopwatch()
        yielded = self._advance(inbox)
        self.last_compute = self._stopwatch() - began
        self.compute += self.last_compute
        if self._noted is not None and self._unfinished_record is not None:  # the notes on an inbox are there now
            self.log.append(RoundRecord(*self._unfinished_record, self._noted()))
        if self.finished:
            return False
        if inbox is not None and inbox.stop:
            raise AlgorithmError(f"{self._round}: the algorithm went on after inbox.stop")
        self._take(yielded)
        self.rounds += 1
        return True

    @property
    def keeps_log(self) -> bool:
        """Whether there is a log of rounds."""
        return self._noted is not None

    def note_round(self, own: Mapping[Any, Any], received_at: dict[int, int]) -> None:
        """Begin the record of the round whose inbox the dialogue is resumed with next."""
        self._unfinished_record = own, self.residual, received_at

    @property
    def result(self) -> T:
        """Return value of the dialogue."""
        return self._result

    @property
    def _round(self) -> str:
        return f"{self.place} round {self.rounds}"

    def _advance(self, inbox: Inbox | None) -> Any:
        """Return what the dialogue yields next, or set `finished`."""
        try:
            return next(self._dialogue) if inbox is None else self._dialogue.send(inbox)
        except StopIteration as finished:
            self.finished = True
            self._result = finished.value
            return None
        except AlgorithmError as error:
            raise AlgorithmError(f"{self._round}: {error}") from error
        except DcfError:
            raise
        except (Exception, SystemExit) as error:
            raise AlgorithmError(f"{self._round}: {account(error)}") from error

    def _take(self, yielded: Any) -> None:
        """Check and keep a residual and its payload; the content of the payload is checked when it is sent."""
        try:
            self.payload, residual = yielded
            self.residual = float(residual)
        except (TypeError, ValueError):
            raise AlgorithmError(
                f"{self._round}: the algorithm yielded {yielded!r:.60}; expected a payload and a residual"
            ) from None
        if self.residual != self.residual:
            raise NumericalError(
                f"{self._round}: the algorithm's residual is not a number; it diverges if a step size is too large"
            )
        if self.residual < 0:
            raise AlgorithmError(
                f"{self._round}: the algorithm's residual is {self.residual:g}; expected a number >= 0"
            )
