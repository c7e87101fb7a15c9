"""Rounds: how an agent's algorithm talks with its neighbours, the same over Zenoh and in the simulator."""

import math
from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Generic, NamedTuple, TypeVar

from dcf_zenoh.agreement import Agreement, Header
from dcf_zenoh.algorithms.algorithm import Dialogue, Inbox, PerNeighbour
from dcf_zenoh.errors import AlgorithmError, MessageError, NumericalError
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.messaging.mailbox import Delivery, Mailbox
from dcf_zenoh.messaging.message import Last, Message, Payload, canonical
from dcf_zenoh.requests import NEVER, Loop, Publish, Wait
from dcf_zenoh.spec import Rounds, nanoseconds

T = TypeVar("T")
_NO_HEADER = Header()
_NO_PAYLOAD: Payload = MappingProxyType({})


@dataclass(slots=True)
class LinkCount:
    """What came over one link in one step, in messages."""

    received: int = 0  # in time for its round
    missing: int = 0  # not there when its round ended
    late: int = 0  # came after its round had ended


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


@dataclass(slots=True)
class _Step:
    """What belongs to one step and is forgotten after it."""

    number: int
    senders: tuple[int, ...]
    links: dict[int, LinkCount]
    heard: dict[int, Delivery] = field(default_factory=dict)  # newest of each neighbour
    names: Set[Any] = frozenset()  # of the own payload
    names_since: int = 0  # round since which the own payload has had these names


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
        self._stopwatch = stopwatch
        self._noted = noted
        self._incarnation = incarnation
        self._sequence = 0
        self._coming: dict[int, list[Delivery]] = {}  # consumed from the mailbox, not due yet
        self._last_heard: dict[int, int] = {}  # neighbour -> fleet time, ns

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
            AlgorithmError: The dialogue broke the contract.
            NumericalError: A residual is not a number.
        """
        settings, hood = self._settings, self._neighbourhood(step)
        agreement = Agreement(
            hood.diameter, len(hood.receives_from), settings.threshold, settings.margin, settled=settled
        )
        talk = _Step(step, hood.receives_from, {j: LinkCount() for j in hood.receives_from})
        log: list[RoundRecord] = []
        heard: tuple[Mapping[Any, Any], float, dict[int, int]] | None = None  # of the round to be logged
        inbox: Inbox | None = None
        residual, compute, stopped_by, round = math.inf, 0, "", 0
        while True:
            began = self._stopwatch()
            try:
                said = next(dialogue) if inbox is None else dialogue.send(inbox)
            except StopIteration as finished:
                compute += self._stopwatch() - began
                self._note(log, heard)
                if stopped_by in ("", "budget"):  # the others cannot know that this agent is through
                    yield Publish(self._message(now, step, round, last=Last.OF_STEP))
                return Outcome(
                    now, finished.value, round, residual, stopped_by or "returned", compute, talk.links,
                    agreement.all_settled, log,
                )  # fmt: skip
            compute += self._stopwatch() - began
            self._note(log, heard)
            if stopped_by:
                raise AlgorithmError(f"{self._place(step, round)}: the algorithm went on after inbox.stop")
            payload, residual = self._checked(said, step, round)
            own, now = yield from self._say(payload, hood, step, round, now, agreement.header(residual))
            if own.keys() != talk.names:
                talk.names, talk.names_since = own.keys(), round
            now = yield from self._hear(talk, round, now, min(until, now + self._round_timeout))
            if agreement.conclude(residual, [message for message, _ in talk.heard.values()], round):
                stopped_by = "agreed"
            elif round + 1 >= settings.max_rounds:
                stopped_by = "rounds"
            elif now >= until:
                stopped_by = "budget"
            inbox = self._inbox(talk, own, round, stop=bool(stopped_by))
            if self._noted is not None:
                heard = own, residual, {j: d.due for j, d in talk.heard.items() if d.message.round == round}
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
        """Messages so far: published, and of those that came, duplicates and refused ones."""
        return {
            "published": self._published,
            "duplicates": self._mailbox.duplicates,
            "refused": self._mailbox.refused,
        }

    def departed(self, last: Last) -> bool:
        """Whether a neighbour has said goodbye with `last`."""
        return any(self._mailbox.departed(j) is last for j in self._last_heard)

    def lost_neighbours(self, step: int, now: int, silent_after: int) -> dict[int, str]:
        """Neighbours that died, failed or have been silent for longer than `silent_after` ns, and which it is."""
        found: dict[int, str] = {}
        for j in self._neighbourhood(step).receives_from:
            silence = now - self._last_heard.get(j, 0)
            if j in self._mailbox.lost:
                found[j] = self._mailbox.lost[j]
            elif self._mailbox.departed(j) is Last.FAILED:
                found[j] = "it stopped because of an error"
            elif silence > silent_after and not self._mailbox.knows(j, step, 0):
                found[j] = f"nothing heard for {silence * 1e-9:.2f} s"
        return found

    def _note(self, log: list[RoundRecord], heard: tuple[Mapping[Any, Any], float, dict[int, int]] | None) -> None:
        """Log a round once the algorithm has digested it, so that what it noted belongs to it."""
        if self._noted is not None and heard is not None:
            log.append(RoundRecord(*heard, self._noted()))

    def _place(self, step: int, round: int) -> str:
        return f"agent {self._agent}: step {step} round {round}"

    def _checked(self, said: Any, step: int, round: int) -> tuple[Payload | PerNeighbour, float]:
        """What the dialogue yielded: a payload and a residual."""
        try:
            payload, residual = said
            residual = float(residual)
        except (TypeError, ValueError):
            raise AlgorithmError(
                f"{self._place(step, round)}: the algorithm yielded {said!r:.60}; expected a payload and a residual"
            ) from None
        if math.isnan(residual):
            raise NumericalError(f"{self._place(step, round)}: the algorithm's residual is not a number")
        return payload, residual

    def _say(
        self, payload: Payload | PerNeighbour, hood: Neighbourhood, step: int, round: int, now: int, header: Header
    ) -> Loop[tuple[Mapping[Any, Any], int]]:
        """Publish one round's payload; every out-neighbour gets exactly one message of its sequence number."""
        place = now, step, round, header
        try:
            if not isinstance(payload, PerNeighbour):
                own = canonical(payload)
                now = yield Publish(self._message(*place, payload=own))
                return own, now
            if set(payload.payloads) != set(hood.sends_to):
                raise MessageError(
                    f"PerNeighbour names {sorted(payload.payloads)}; expected exactly its out-neighbours"
                    f" {list(hood.sends_to)}"
                )
            edges = {j: canonical(payload.payloads[j]) for j in hood.sends_to}
        except MessageError as error:
            raise AlgorithmError(f"{self._place(step, round)}: {error}") from error
        message = self._message(*place)
        for j, edge in edges.items():
            now = yield Publish(message._replace(payload=edge), j)
        self._published += len(edges) - 1
        return edges, now

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
        self._published += 1
        return Message(
            self._agent, self._incarnation, sequence, step, round, now, header.stop_at, header.settled_hops, 0, last,
            header.residuals, payload,
        )  # fmt: skip

    def _hear(self, talk: _Step, round: int, now: int, deadline: int) -> Loop[int]:
        """Wait for the messages of `round`, then consume whatever is due at its end."""
        step, mailbox = talk.number, self._mailbox
        now = yield Wait(deadline, talk.senders, step, round)
        end = now
        for j in talk.senders:
            coming = self._coming.setdefault(j, [])
            coming += mailbox.take(j, step, round)
            for message, due in coming:
                if due > end and message.round == round and message.step == step:
                    end = due
        if end > now:
            now = yield Wait(min(end, deadline))
        for j, link in talk.links.items():
            fresh, later = False, []
            for delivery in self._coming[j]:
                message, due = delivery
                if due > now:
                    later.append(delivery)
                    continue
                self._last_heard[j] = due
                if message.last:
                    continue
                if message.step == step:
                    talk.heard[j] = delivery
                    fresh = message.round == round
                link.late += not fresh
            self._coming[j] = later
            link.received += fresh
            link.missing += not fresh and not mailbox.knows(j, step, NEVER)
        return now

    def _inbox(self, talk: _Step, own: Payload, round: int, *, stop: bool) -> Inbox:
        """What the algorithm sees of this round: fresh payloads, held ones, and who is missing."""
        oldest = talk.names_since if self._settings.missing == "hold" else round
        payloads: dict[int, Payload] = {}
        ages: dict[int, int] = {}
        missing: list[int] = []
        for j in talk.senders:
            message = talk.heard[j].message if j in talk.heard else None
            if message is None or message.round < oldest:
                missing.append(j)
                continue
            payloads[j] = message.payload
            if message.round < round:
                ages[j] = round - message.round
        return Inbox(own, payloads, stop=stop, ages=ages, missing=tuple(missing))
