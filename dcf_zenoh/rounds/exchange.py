"""Exchange of messages in one step: the interface of a mode, and the parts that both modes share.

It is the same over Zenoh and in the simulator.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from dcf_zenoh.algorithms.algorithm import Dialogue, Inbox
from dcf_zenoh.errors import AlgorithmError, MessageError, NumericalError
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.message import Last
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.requests import NEVER, Loop, Publish
from dcf_zenoh.rounds.agreement import Agreement
from dcf_zenoh.rounds.dialogue import DialogueRun, RoundRecord
from dcf_zenoh.rounds.receiver import KnownPosition, LinkCount, Note, Receiver
from dcf_zenoh.rounds.sender import Sender, Sent
from dcf_zenoh.spec import Rounds

T = TypeVar("T")


class Outcome(NamedTuple, Generic[T]):
    """Outcome of the rounds of one step.

    Attributes:
        now: Fleet time at the end, ns.
        result: Return value of the dialogue.
        rounds: Number of rounds.
        residual: The agent's own residual of the last round.
        stopped_by: 'agreed', 'rounds' (out of rounds), 'budget' (out of time) or 'returned' (the dialogue ended by
            itself).
        compute: Real time spent in the dialogue, ns.
        links: Neighbour -> counts of its messages.
        passed: Log entries of messages: over links with faults, or over all links where the receiver logs all.
        all_arrived: Whether every agent of the fleet has arrived.
        log: One record per round; empty if the log of rounds is off.
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


@dataclass(frozen=True)
class ComputeTime:
    """Fleet time that the computation of a round takes.

    In virtual time it is `fixed`, times the slowness. On the wall clock computation takes time by itself; a slow agent
    waits for the rest.

    Attributes:
        fixed: Duration of a round's computation, ns; 0 on the wall clock.
        slowness: Fleet time in ns -> factor by which computation takes longer; None: it never does.
        virtual: Whether time is virtual.
    """

    fixed: int = 0
    slowness: Callable[[int], float] | None = None
    virtual: bool = True

    def end(self, now: int, measured: int) -> int:
        """Return when a computation ends that began at `now`, ns, and took `measured` ns of real time."""
        if self.slowness is None:
            return now + self.fixed
        factor = self.slowness(now)
        duration = self.fixed * factor if self.virtual else measured * (factor - 1)
        return now + round(duration)


@dataclass(frozen=True)
class ExchangeOptions:
    """Options of an exchange that do not come from the table ``[exchange]``.

    Attributes:
        stopwatch: Clock in real ns, to measure computation; in virtual time it never enters a decision.
        noted: Returns what the algorithm notes for the log of a round; None: no log of rounds.
        compute_time: Fleet time that computation takes.
        share_position: Whether messages contain the position of the agent.
    """

    stopwatch: Callable[[], int]
    noted: Callable[[], Mapping[str, Any]] | None = None
    compute_time: ComputeTime = ComputeTime()
    share_position: bool = False


class StepExchange(NamedTuple, Generic[T]):
    """Exchange of one step, as a mode sees it.

    Attributes:
        dialogue: The dialogue; resumed by the mode.
        neighbourhood: Neighbours of the agent.
        agreement: Agreement on the end of the step.
        receiver: The receiving half.
        sender: The sending half.
        compute_time: Time that computation takes.
        step: Control step k; below 0 before the start.
        now: Fleet time at the beginning, ns.
        until: End of the step's time budget, ns.
        next_step: Beginning of the next step, ns.
    """

    dialogue: DialogueRun[T]
    neighbourhood: Neighbourhood
    agreement: Agreement
    receiver: Receiver
    sender: Sender
    compute_time: ComputeTime
    step: int
    now: int
    until: int
    next_step: int

    def messages(self, round: int, now: int, promise: int = 0) -> Sent:
        """Return the messages of `round`, to be published at `now`.

        Raises:
            AlgorithmError: The payload cannot be sent.
            NumericalError: The payload is not finite.
        """
        dialogue = self.dialogue
        header = self.agreement.header(dialogue.residual)
        try:
            return self.sender.round(dialogue.payload, self.neighbourhood, self.step, round, now, header, promise)
        except MessageError as error:
            raise AlgorithmError(f"{dialogue.place} round {round}: {error}") from error
        except NumericalError as error:
            raise NumericalError(
                f"{dialogue.place} round {round}: the algorithm's {error}; it diverges if a step size is too large"
            ) from error

    def inbox(self, sent: Sent, round: int, *, stop: bool, synchronous: bool = True) -> Inbox:
        """Return the inbox of the algorithm in `round`."""
        if self.dialogue.keeps_log:
            self.dialogue.note_round(sent.own, self.receiver.received_at(round))
        return self.receiver.inbox(sent.own, sent.names, round, stop=stop, synchronous=synchronous)

    def computed(self, now: int) -> int:
        """Return the instant at which the dialogue's last computation ends, fleet time, ns."""
        return self.compute_time.end(now, self.dialogue.last_compute)


class ExchangeMode(Protocol):
    """Order of the rounds of a step, synchronous or asynchronous."""

    def run(self, exchange: StepExchange[Any]) -> Loop[tuple[int, str]]:
        """Exchange messages until the dialogue has returned; return the fleet time then, ns, and what ended it.

        See `Outcome.stopped_by` for the second.
        """
        ...


class Exchange:
    """Exchange of one agent with its neighbours.

    Args:
        agent: Id of this agent.
        neighbourhood: Its neighbours.
        settings: Table ``[exchange]`` of the fleet file.
        mailbox: Messages received by the runner.
        receiver: The receiving half, which reads `mailbox`.
        sender: The sending half.
        mode: Synchronous or asynchronous.
        options: Further options.
    """

    def __init__(
        self,
        agent: int,
        neighbourhood: Neighbourhood,
        settings: Rounds,
        mailbox: Mailbox,
        receiver: Receiver,
        sender: Sender,
        mode: ExchangeMode,
        options: ExchangeOptions,
    ) -> None:
        self._agent = agent
        self._neighbourhood = neighbourhood
        self._settings = settings
        self._mailbox = mailbox
        self._receiver = receiver
        self._sender = sender
        self._mode = mode
        self._options = options
        self._goodbyes: dict[int, int] = {}  # neighbour -> instant at which its goodbye was first seen, ns

    def negotiate(
        self,
        dialogue: Dialogue[T],
        step: int,
        now: int,
        *,
        until: int = NEVER,
        next_step: int = NEVER,
        arrived: bool = False,
        position: tuple[float, ...] = (),
    ) -> Loop[Outcome[T]]:
        """Lead `dialogue` through the rounds of one step.

        Args:
            dialogue: An algorithm, or another generator with its contract.
            step: Control step k; below 0 before the start.
            now: Fleet time, ns.
            until: End of the step's time budget, ns.
            next_step: Beginning of the next step, ns.
            arrived: Whether this agent has arrived; the fleet agrees on that by the way.
            position: Position of this agent, m.

        Raises:
            AlgorithmError: The dialogue broke the contract, or raised an exception.
            NumericalError: A residual is not a number, or a payload is not finite.
        """
        neighbourhood, settings, options = self._neighbourhood, self._settings, self._options
        agreement = Agreement(
            neighbourhood.diameter,
            len(neighbourhood.receives_from),
            settings.threshold,
            settings.margin or 0,
            arrived=arrived,
        )
        run = DialogueRun(dialogue, f"agent {self._agent}: step {step}", options.stopwatch, options.noted)
        self._sender.position = position if options.share_position else ()
        self._receiver.begin(step, neighbourhood.receives_from, position)
        now, stopped_by = yield from self._mode.run(
            StepExchange(
                run,
                neighbourhood,
                agreement,
                self._receiver,
                self._sender,
                options.compute_time,
                step,
                now,
                until,
                next_step,
            )
        )
        return Outcome(
            now, run.result, run.rounds, run.residual, stopped_by, run.compute, self._receiver.links,
            self._receiver.passed, agreement.all_arrived, run.log,
        )  # fmt: skip

    def cut_short(self, step: int) -> tuple[dict[int, LinkCount], list[Note]]:
        """Return the counts and log entries of `step`, which broke off."""
        return self._receiver.cut_short(step)

    def abstain(self, step: int, now: int, next_step: int) -> Publish:
        """Return the message by which this agent takes no part in `step`."""
        return Publish(self._sender.message(now, step, last=Last.OF_STEP, promise=next_step))

    def goodbye(self, step: int, now: int, last: Last) -> Publish:
        """Return the last message of this agent."""
        return Publish(self._sender.message(now, step, last=last))

    def away(self, step: int, now: int, until: int) -> Publish:
        """Return the message that nothing follows before `step`, nor before `until`, ns; see `Sender.away`."""
        return self._sender.away(step, now, until)

    @property
    def counts(self) -> dict[str, int]:
        """Messages so far: those published here, and those of neighbours that never came or were not accepted."""
        return {
            "published": self._sender.published,
            "lost": self._mailbox.missing,
            "overtaken": self._mailbox.overtaken,
            "duplicates": self._mailbox.duplicates,
            "refused": self._mailbox.refused,
        }

    @property
    def unmet(self) -> list[tuple[int, str, str]]:
        """Link faults that never had anything to act on: neighbour, name, description of what was missing."""
        return self._receiver.unmet

    def departed(self, last: Last) -> bool:
        """Return whether a goodbye of kind `last` has been received, as far as the model may know of it."""
        return last in self._receiver.departed.values()

    @property
    def positions(self) -> Mapping[int, KnownPosition]:
        """Neighbour -> its newest position that has been received; see `Receiver`."""
        return self._receiver.positions

    def lost_neighbours(self, now: int, lost_after: int, confirmed_after: int = 0) -> dict[int, str]:
        """Return the neighbours that died, failed, landed or have been silent for longer than `lost_after` ns.

        Args:
            now: Fleet time, ns.
            lost_after: Longest silence, ns.
            confirmed_after: Time for which nothing may follow a goodbye before it is believed, ns. One that another
                sender has made up is revoked by the next messages of the neighbour.

        Returns:
            Neighbour -> the reason, in words.
        """
        found = {}
        for j in self._neighbourhood.receives_from:
            silence = now - self._receiver.last_received.get(j, 0)
            if j in self._mailbox.lost:
                found[j] = self._mailbox.lost[j]
                continue
            said = self._said_goodbye(j)
            since = self._goodbyes.setdefault(j, now) if said else self._goodbyes.pop(j, now)
            if said and now - since >= confirmed_after:
                found[j] = said
            elif silence > lost_after:
                found[j] = f"nothing heard for {silence * 1e-9:.2f} s"
        return found

    def _said_goodbye(self, j: int) -> str:
        """Return how a neighbour has ended its flight early, by its goodbye; empty if it has not."""
        if self._mailbox.departed(j) is Last.FAILED:
            return "it stopped because of an error"
        return "it has landed" if self._receiver.departed.get(j) is Last.LANDED else ""
