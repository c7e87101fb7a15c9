"""Rounds: how an agent's algorithm talks with its neighbours, the same over Zenoh and in the simulator."""

from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar

from dcf_zenoh.algorithms.algorithm import Dialogue, Inbox
from dcf_zenoh.errors import AlgorithmError, MessageError
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.message import Last
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.requests import NEVER, Activate, Loop, Publish, Wait
from dcf_zenoh.rounds.activation import ActivationSchedule
from dcf_zenoh.rounds.agreement import Agreement, Header
from dcf_zenoh.rounds.dialogue import DialogueRun, RoundRecord
from dcf_zenoh.rounds.receiver import LinkCount, Note, Receiver
from dcf_zenoh.rounds.sender import Sender, Sent
from dcf_zenoh.spec import Rounds, nanoseconds

T = TypeVar("T")


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
        passed: What the links did to messages, as far as they have faults or it is to be logged.
        all_arrived: Every agent of the fleet has arrived.
        log: One record per round, if those were asked for.
    """

    now: int
    result: T
    rounds: int
    residual: float
    stopped_by: str
    compute: int
    links: dict[int, LinkCount]
    passed: list[Note]
    all_arrived: bool
    log: list[RoundRecord]


class Exchange:
    """Rounds of one agent with its neighbours.

    Synchronous: a round ends when every in-neighbour's message of that round is there, or at the round's time-out, or
    at the end of the step's time budget, whichever comes first. With a `rhythm`, asynchronous: a round is an activation
    at an instant of the agent's own, with the freshest message of each neighbour.

    Args:
        agent: Id of this agent.
        neighbourhood: Step -> whom the agent hears and who hears it.
        settings: Of the fleet file.
        mailbox: Where the runner puts what arrives.
        receiver: Takes it from there.
        sender: Numbers what is sent.
        stopwatch: Real time in ns, to measure computation; in virtual time it never enters a decision.
        noted: What the algorithm wants to see in the log of a round; None to keep no log of rounds.
        rhythm: Of the agent's activations; None in synchronous mode.
        slowness: Fleet time in ns -> factor by which computing takes longer; None if it never does.
        virtual: Computing takes the time that the settings say, and promises are needed.
        tells_position: Its messages say where the agent is.
    """

    def __init__(
        self,
        agent: int,
        neighbourhood: Callable[[int], Neighbourhood],
        settings: Rounds,
        mailbox: Mailbox,
        receiver: Receiver,
        sender: Sender,
        stopwatch: Callable[[], int],
        *,
        noted: Callable[[], Mapping[str, Any]] | None = None,
        rhythm: ActivationSchedule | None = None,
        slowness: Callable[[int], float] | None = None,
        virtual: bool = True,
        tells_position: bool = False,
    ) -> None:
        self._agent = agent
        self._neighbourhood = neighbourhood
        self._settings = settings
        self._round_timeout = NEVER if settings.round_timeout is None else nanoseconds(settings.round_timeout)
        self._compute_time = nanoseconds(settings.compute_time) if virtual else 0
        self._margin = settings.margin or 0
        self._mailbox = mailbox
        self._receiver = receiver
        self._sender = sender
        self._stopwatch = stopwatch
        self._noted = noted
        self._rhythm = rhythm
        self._slowness = slowness
        self._virtual = virtual
        self._tells_position = tells_position

    def negotiate(
        self,
        dialogue: Dialogue[T],
        step: int,
        now: int,
        *,
        until: int = NEVER,
        next_step: int = NEVER,
        arrived: bool = False,
        here: tuple[float, ...] = (),
    ) -> Loop[Outcome[T]]:
        """Lead `dialogue` through the rounds of one step.

        Args:
            dialogue: An algorithm, or whatever speaks its contract.
            step: Control step k.
            now: Fleet time, ns.
            until: End of the step's time budget, ns.
            next_step: When the next step begins, ns.
            arrived: Whether this agent has arrived, to be agreed upon on the way.
            here: Where this agent is, m.

        Raises:
            AlgorithmError: The dialogue broke the contract, or raised an exception.
            NumericalError: A residual is not a number.
        """
        hood = self._neighbourhood(step)
        agreement = Agreement(
            hood.diameter, len(hood.receives_from), self._settings.threshold, self._margin, arrived=arrived
        )
        talk = DialogueRun(dialogue, f"agent {self._agent}: step {step}", self._stopwatch, self._noted)
        self._sender.position = here if self._tells_position else ()
        self._receiver.begin(step, hood.receives_from, here)
        if self._rhythm is None or step < 0:  # the start is agreed upon in step
            now, stopped_by = yield from self._rounds(talk, hood, agreement, step, now, until)
        else:
            now, stopped_by = yield from self._activations(
                talk, hood, agreement, self._rhythm, step, now, until, next_step
            )
        return Outcome(
            now, talk.result, talk.rounds, talk.residual, stopped_by, talk.compute, self._receiver.links,
            self._receiver.passed, agreement.all_arrived, talk.log,
        )  # fmt: skip

    def _rounds(
        self, talk: DialogueRun[T], hood: Neighbourhood, agreement: Agreement, step: int, now: int, until: int
    ) -> Loop[tuple[int, str]]:
        """Synchronous rounds; when they ended, and why."""
        timeout = self._round_timeout if step >= 0 else NEVER  # before the start there is time
        receiver, senders = self._receiver, hood.receives_from
        inbox: Inbox | None = None
        stopped_by = ""
        while talk.resume(inbox):
            round = talk.rounds - 1
            sent = self._sent(talk, hood, step, round, now, agreement.header(talk.residual))
            for publication in sent.publications:
                now = yield publication
            deadline = min(until, now + timeout)
            if senders:
                now = yield Wait(deadline, senders, step, round)
            end = receiver.round_end(round, now, deadline)
            if end > now:
                now = yield Wait(end)
            receiver.close(round, now)
            if agreement.conclude(talk.residual, receiver.messages, round):
                stopped_by = "agreed"
            elif round + 1 >= self._settings.max_rounds:
                stopped_by = "rounds"
            elif now >= until:
                stopped_by = "budget"
            inbox = self._inbox(talk, sent, round, stop=bool(stopped_by))
            if step >= 0 and (end := self._computed(talk, now)) > now:
                now = yield Wait(end)
        if stopped_by in ("", "budget") or self._margin:  # the others may not know that it is through
            yield Publish(self._sender.message(now, step, talk.rounds, last=Last.OF_STEP))
        return now, stopped_by or "returned"

    def _activations(
        self,
        talk: DialogueRun[T],
        hood: Neighbourhood,
        agreement: Agreement,
        rhythm: ActivationSchedule,
        step: int,
        now: int,
        until: int,
        next_step: int,
    ) -> Loop[tuple[int, str]]:
        """Activations at instants of the agent's own; when they ended, and why."""
        receiver, senders = self._receiver, hood.receives_from
        inbox: Inbox | None = None
        stopped_by = ""
        activation = now
        while talk.resume(inbox):
            round = talk.rounds - 1
            if (end := self._computed(talk, now)) > now:
                now = yield Wait(end)
            activation = max(rhythm.after(activation), now + 1)
            if activation >= until:
                stopped_by, activation = "budget", max(until, now + 1)
            elif round + 1 >= self._settings.max_rounds:
                stopped_by = "rounds"
            # Nothing leaves before the next activation; after the last one, not before the next step.
            promise = max(next_step, activation) if stopped_by else activation
            sent = self._sent(talk, hood, step, round, now, agreement.header(talk.residual), promise)
            for publication in sent.publications:
                now = yield publication
            now = yield Activate(activation, senders)
            receiver.activate(round, now)
            agreement.note_arrived(receiver.messages)
            inbox = self._inbox(talk, sent, round, stop=bool(stopped_by), synchronous=False)
        if (end := self._computed(talk, now)) > now:
            now = yield Wait(end)
        if not stopped_by:
            last = self._sender.message(now, step, talk.rounds, last=Last.OF_STEP, promise=max(next_step, now))
            yield Publish(last)
        return now, stopped_by or "returned"

    def _sent(
        self,
        talk: DialogueRun[T],
        hood: Neighbourhood,
        step: int,
        round: int,
        now: int,
        header: Header,
        promise: int = 0,
    ) -> Sent:
        """One round's messages; a payload that cannot be sent is the algorithm's error."""
        try:
            return self._sender.round(talk.payload, hood, step, round, now, header, promise)
        except MessageError as error:
            raise AlgorithmError(f"agent {self._agent}: step {step} round {round}: {error}") from error

    def _inbox(self, talk: DialogueRun[T], sent: Sent, round: int, *, stop: bool, synchronous: bool = True) -> Inbox:
        """What the algorithm sees of `round`."""
        if talk.logs:
            talk.hear(sent.own, self._receiver.received_at(round))
        return self._receiver.inbox(sent.own, sent.names, round, stop=stop, synchronous=synchronous)

    def _computed(self, talk: DialogueRun[T], now: int) -> int:
        """When a round's computation is done: after what the settings say, or on the wall clock what is too much."""
        if self._slowness is None:
            return now + self._compute_time
        factor = self._slowness(now)
        duration = self._compute_time * factor if self._virtual else talk.last_compute * (factor - 1)
        return now + round(duration)

    def cut_short(self, step: int) -> tuple[dict[int, LinkCount], list[Note]]:
        """What had come in `step` when it broke off."""
        return self._receiver.cut_short(step)

    def abstain(self, step: int, now: int, next_step: int) -> Publish:
        """Tell the neighbours that this agent takes no part in `step`."""
        return Publish(self._sender.message(now, step, last=Last.OF_STEP, promise=next_step))

    def goodbye(self, step: int, now: int, last: Last) -> Publish:
        """The last message of this agent."""
        return Publish(self._sender.message(now, step, last=last))

    def away(self, step: int, now: int, until: int) -> Publish:
        """Tell the runners of the neighbours that nothing follows before `step`, nor before `until`, ns."""
        return Publish(self._sender.message(now, step, last=Last.AWAY, promise=until))

    @property
    def counts(self) -> dict[str, int]:
        """Messages so far: published here; and of the neighbours', those that never came and those not accepted."""
        return {
            "published": self._sender.published,
            "lost": self._mailbox.missing,
            "overtaken": self._mailbox.overtaken,
            "duplicates": self._mailbox.duplicates,
            "refused": self._mailbox.refused,
        }

    @property
    def unmet(self) -> list[tuple[int, str, str]]:
        """Faults of links that were to act on what no message had: neighbour, name, what that was."""
        return self._receiver.unmet

    def departed(self, last: Last) -> bool:
        """Whether a neighbour has said goodbye with `last`, as far as the model knows."""
        return last in self._receiver.departed.values()

    @property
    def positions(self) -> dict[int, tuple[float, ...]]:
        """Neighbour -> where it said to be in its newest message of this step, m, of those who told."""
        return {message.sender: message.position for message in self._receiver.messages if message.position}

    def lost_neighbours(self, step: int, now: int, silent_after: int) -> dict[int, str]:
        """Neighbours that died, failed or have been silent for longer than `silent_after` ns, and which it is."""
        found = {}
        for j in self._neighbourhood(step).receives_from:
            silence = now - self._receiver.last_heard.get(j, 0)
            if dead := self._mailbox.dead(j):
                found[j] = dead
            elif self._receiver.departed.get(j) is Last.LANDED:
                found[j] = "it has landed"
            elif silence > silent_after:
                found[j] = f"nothing heard for {silence * 1e-9:.2f} s"
        return found
