"""Rounds: how an agent's algorithm talks with its neighbours, the same over Zenoh and in the simulator."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Generic, NamedTuple, TypeVar

from dcf_zenoh.agreement import Agreement, Header
from dcf_zenoh.algorithms.algorithm import Dialogue, Inbox, PerNeighbour
from dcf_zenoh.errors import AlgorithmError, DcfError, MessageError, NumericalError, account
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.messaging.message import Last, Message, Payload, canonical
from dcf_zenoh.reception import LinkCount, Reception
from dcf_zenoh.requests import NEVER, Loop, Publish, Wait
from dcf_zenoh.spec import Rounds, nanoseconds

T = TypeVar("T")
_NO_HEADER = Header()
_NO_PAYLOAD: Payload = MappingProxyType({})


class RoundRecord(NamedTuple):
    """One round, as the log keeps it.

    Attributes:
        payload: What the agent sent; of edge payloads, neighbour -> payload.
        residual: The agent's own.
        arrivals: Neighbour -> fleet time at which its message of this round was there, ns.
        noted: What the algorithm wanted to show (`Me.note`).
    """

    payload: Mapping[Any, Any]
    residual: float
    arrivals: dict[int, int]
    noted: Mapping[str, Any]


class Outcome(NamedTuple, Generic[T]):
    """What came of the rounds of one step.

    Attributes:
        now: Fleet time at the end, ns.
        result: What the dialogue returned.
        rounds: How many rounds there were.
        residual: The agent's own residual of the last round.
        stopped_by: 'agreed', 'rounds' (out of rounds), 'budget' (out of time) or 'returned' (of its own accord).
        compute: Real time spent in the dialogue, ns.
        links: Neighbour -> what came from it.
        all_settled: Every agent of the fleet has arrived.
        log: One record per round, if those were asked for.
    """

    now: int
    result: T
    rounds: int
    residual: float
    stopped_by: str
    compute: int
    links: dict[int, LinkCount]
    all_settled: bool
    log: list[RoundRecord]


class Exchange:
    """Synchronous rounds of one agent with its neighbours.

    A round ends when every in-neighbour's message of that round is there, or at the round's time-out, or at the end
    of the step's time budget, whichever comes first.

    Args:
        agent: Id of this agent.
        neighbourhood: Step -> whom the agent hears and who hears it.
        settings: Of the fleet file.
        mailbox: Where the runner puts what arrives.
        stopwatch: Real time in ns, to measure computation; it never enters a decision.
        noted: What the algorithm wants to see in the log of a round; None to keep no log of rounds.
        incarnation: How often this agent was restarted in this run.

    """

    def __init__(
        self,
        agent: int,
        neighbourhood: Callable[[int], Neighbourhood],
        settings: Rounds,
        mailbox: Mailbox,
        stopwatch: Callable[[], int],
        *,
        noted: Callable[[], Mapping[str, Any]] | None = None,
        incarnation: int = 0,
    ) -> None:
        self._published = 0
        self._agent = agent
        self._neighbourhood = neighbourhood
        self._settings = settings
        self._round_timeout = NEVER if settings.round_timeout is None else nanoseconds(settings.round_timeout)
        self._compute_time = nanoseconds(settings.compute_time)
        self._mailbox = mailbox
        self._reception = Reception(mailbox, hold=settings.missing == "hold")
        self._stopwatch = stopwatch
        self._noted = noted
        self._incarnation = incarnation
        self._sequence = 0

    def negotiate(
        self, dialogue: Dialogue[T], step: int, now: int, *, until: int = NEVER, settled: bool = False
    ) -> Loop[Outcome[T]]:
        """Lead `dialogue` through the rounds of one step.

        Args:
            dialogue: An algorithm, or whatever speaks its contract.
            step: Control step k.
            now: Fleet time, ns.
            until: End of the step's time budget, ns.
            settled: Whether this agent has arrived, to be agreed upon on the way.

        Raises:
            AlgorithmError: The dialogue broke the contract, or raised an exception.
            NumericalError: A residual is not a number.
        """
        settings, hood = self._settings, self._neighbourhood(step)
        agreement = Agreement(
            hood.diameter, len(hood.receives_from), settings.threshold, settings.margin or 0, settled=settled
        )
        reception, senders = self._reception, hood.receives_from
        reception.begin(step, senders)
        log: list[RoundRecord] = []
        heard: tuple[Mapping[Any, Any], float, dict[int, int]] | None = None  # of the round to be logged
        inbox: Inbox | None = None
        residual, compute, stopped_by, round = math.inf, 0, "", 0
        while True:
            began = self._stopwatch()
            said = self._resume(dialogue, inbox, step, round)
            compute += self._stopwatch() - began
            if self._noted is not None and heard is not None:  # digested now: what was noted belongs to it
                log.append(RoundRecord(*heard, self._noted()))
            if isinstance(said, StopIteration):
                if stopped_by in ("", "budget"):  # the others cannot know that this agent is through
                    yield Publish(self._message(now, step, round, last=Last.OF_STEP))
                return Outcome(
                    now, said.value, round, residual, stopped_by or "returned", compute, reception.links,
                    agreement.all_settled, log,
                )  # fmt: skip
            payload, residual = said
            own, publications = self._publications(payload, hood, step, round, now, agreement.header(residual))
            for publication in publications:
                now = yield publication
            deadline = min(until, now + self._round_timeout)
            if senders:
                now = yield Wait(deadline, senders, step, round)
            end = reception.complete_at(round, now)
            if end > now:
                now = yield Wait(min(end, deadline))
            reception.close(round, now)
            if agreement.conclude(residual, reception.messages, round):
                stopped_by = "agreed"
            elif round + 1 >= settings.max_rounds:
                stopped_by = "rounds"
            elif now >= until:
                stopped_by = "budget"
            inbox = reception.inbox(own, round, stop=bool(stopped_by))
            if self._noted is not None:
                heard = own, residual, reception.arrivals(round)
            if self._compute_time:
                now = yield Wait(now + self._compute_time)
            round += 1

    def abstain(self, step: int, now: int) -> Publish:
        """Tell the neighbours that this agent takes no part in `step`."""
        return Publish(self._message(now, step, 0, last=Last.OF_STEP))

    def goodbye(self, step: int, now: int, last: Last) -> Publish:
        """The last message of this agent."""
        return Publish(self._message(now, step, 0, last=last))

    @property
    def counts(self) -> dict[str, int]:
        """Messages so far: published here; and of the neighbours', those that never came and those not accepted."""
        return {
            "published": self._published,
            "lost": self._mailbox.missing,
            "overtaken": self._mailbox.overtaken,
            "duplicates": self._mailbox.duplicates,
            "refused": self._mailbox.refused,
        }

    def departed(self, last: Last) -> bool:
        """Whether a neighbour has said goodbye with `last`, as far as the model knows."""
        return last in self._reception.departed.values()

    def lost_neighbours(self, step: int, now: int, silent_after: int) -> dict[int, str]:
        """Neighbours that died, failed or have been silent for longer than `silent_after` ns, and which it is."""
        found: dict[int, str] = {}
        for j in self._neighbourhood(step).receives_from:
            silence = now - self._reception.last_heard.get(j, 0)
            if j in self._mailbox.lost:
                found[j] = self._mailbox.lost[j]
            elif self._mailbox.departed(j) is Last.FAILED:
                found[j] = "it stopped because of an error"
            elif silence > silent_after and not self._mailbox.knows(j, step, 0):
                found[j] = f"nothing heard for {silence * 1e-9:.2f} s"
        return found

    def _place(self, step: int, round: int) -> str:
        return f"agent {self._agent}: step {step} round {round}"

    def _resume(
        self, dialogue: Dialogue[Any], inbox: Inbox | None, step: int, round: int
    ) -> tuple[Payload | PerNeighbour, float] | StopIteration:
        """The dialogue's next payload and residual, checked; or its end, which holds what it returned."""
        try:
            said = next(dialogue) if inbox is None else dialogue.send(inbox)
        except StopIteration as finished:
            return finished
        except AlgorithmError as error:
            raise AlgorithmError(f"{self._place(step, round)}: {error}") from error
        except DcfError:
            raise
        except (Exception, SystemExit) as error:
            raise AlgorithmError(f"{self._place(step, round)}: {account(error)}") from error
        if inbox is not None and inbox.stop:
            raise AlgorithmError(f"{self._place(step, round)}: the algorithm went on after inbox.stop")
        try:
            payload, residual = said
            residual = float(residual)
        except (TypeError, ValueError):
            raise AlgorithmError(
                f"{self._place(step, round)}: the algorithm yielded {said!r:.60}; expected a payload and a residual"
            ) from None
        if residual != residual:  # noqa: PLR0124 - NaN
            raise NumericalError(f"{self._place(step, round)}: the algorithm's residual is not a number")
        return payload, residual

    def _publications(
        self, payload: Payload | PerNeighbour, hood: Neighbourhood, step: int, round: int, now: int, header: Header
    ) -> tuple[Mapping[Any, Any], list[Publish]]:
        """One round's messages: every out-neighbour gets exactly one of this sequence number."""
        try:
            if not isinstance(payload, PerNeighbour):
                own = canonical(payload)
                return own, [Publish(self._message(now, step, round, header, payload=own))]
            if set(payload.payloads) != set(hood.sends_to):
                raise MessageError(
                    f"PerNeighbour names {sorted(payload.payloads)}; expected exactly its out-neighbours"
                    f" {list(hood.sends_to)}"
                )
            edges = {j: canonical(payload.payloads[j]) for j in hood.sends_to}
        except MessageError as error:
            raise AlgorithmError(f"{self._place(step, round)}: {error}") from error
        message = self._message(now, step, round, header)
        self._published += len(edges) - 1
        return edges, [Publish(message._replace(payload=edge), j) for j, edge in edges.items()]

    def _message(
        self,
        now: int,
        step: int,
        round: int,
        header: Header = _NO_HEADER,
        last: Last = Last.NO,
        payload: Payload = _NO_PAYLOAD,
    ) -> Message:
        """The next message of this agent."""
        sequence = self._sequence
        self._sequence += 1
        self._published += step >= 0 and last < Last.DONE  # what the links of the steps carry
        return Message(
            self._agent, self._incarnation, sequence, step, round, now, header.stop_at, header.settled_hops, 0, last,
            header.residuals, payload,
        )  # fmt: skip
