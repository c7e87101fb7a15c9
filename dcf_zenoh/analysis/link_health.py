"""Loss and latency of the links of a run, as far as its logs record them.

Single messages are recorded of links with faults, and on the wall clock of all links. Other links in virtual time lose
and delay nothing; of them, messages are only counted.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dcf_zenoh.faults.profile import LinkProfile
from dcf_zenoh.plant import Array, read_only
from dcf_zenoh.records.agent_log import AgentLog, Integers
from dcf_zenoh.records.run import Run
from dcf_zenoh.spec import nanoseconds

NETWORK = "the network"  # cause of a loss that no fault made
_LEAST = 1000  # ns between two messages of one agent; no agent is nearly as fast
_SLACK = 1_000_000  # ns, because stamps depend on clock offsets
_QUANTILES = 201  # of a profile: one for every half per cent


class Crossing(NamedTuple):
    """Passage of one message over a link. Times are fleet time in ns.

    Attributes:
        sequence: Sequence number; numbers begin again when the sender is restarted.
        step: Control step in which it was sent.
        round: Round in which it was sent.
        lost_by: Name of the fault that lost it, or `NETWORK`; empty if it was received.
        entered: Instant at which it entered the link; -1 if the network lost it.
        due: Instant at which it was first received; -1 if it was lost.
        copies: Number of further copies received.
        waited: Whether the receiver's loop found it when it woke up for a control step, on the wall clock; then its
            latency is not known.
    """

    sequence: int
    step: int
    round: int
    lost_by: str
    entered: int
    due: int
    copies: int = 0
    waited: bool = False

    @property
    def latency(self) -> float | None:
        """Latency, s; None where the message was lost, or the latency is not known."""
        return None if self.lost_by or self.waited else (self.due - self.entered) * 1e-9


@dataclass(frozen=True)
class LinkHealth:
    """Measurements of one directed link over a run.

    On the wall clock a message is received when the receiver's loop has read it. So its latency includes waiting for
    the loop: for other messages that are read first, and for computations. Messages that the loop found when it woke up
    for a control step may have waited since the last step; they do not count in `latencies`.

    Attributes:
        sender: Id of the sender.
        receiver: Id of the receiver.
        recorded: Whether the log records single messages; otherwise they are only counted.
        crossings: Passage of each message, in the order of sending; empty if not `recorded`. Messages that were still
            on their way at the end are left out.
        per_step: Messages sent in each step, messages lost of these, and messages late in that step of the receiver;
            shape (K, 3).
        missing: Rounds of the receiver that ended without the message of that round.
        latencies: Latencies of the messages received, ascending, s.
        longest_gap: Longest time without a message, from the nominal begin of the receiver's first step to the end of
            its last, s; None if not `recorded`.
        clock_ahead: Offset of the sender's clock from the receiver's at the handshake, s; positive if it is ahead. None
            in virtual time and where it is not known. Latencies are corrected for it where it exceeds its error.
        clock_error: Bound on the error of `clock_ahead`, s.
    """

    sender: int
    receiver: int
    recorded: bool
    crossings: tuple[Crossing, ...]
    per_step: Integers
    missing: int
    latencies: Array
    longest_gap: float | None
    clock_ahead: float | None
    clock_error: float | None

    @cached_property
    def sent(self) -> int:
        """Number of messages sent over the link."""
        return len(self.crossings) if self.recorded else int(self.per_step[:, 0].sum())

    @cached_property
    def lost(self) -> Mapping[str, int]:
        """Cause of loss -> number of messages.

        The network lost the messages whose sequence numbers are missing between others, on the wall clock alone, and
        not while the receiver was absent. A message that came after its number had been given up counts as lost too.
        """
        return dict(sorted(Counter(each.lost_by for each in self.crossings if each.lost_by).items()))

    @property
    def loss(self) -> float:
        """Share of messages that were lost, by any cause."""
        return sum(self.lost.values()) / self.sent if self.sent else 0.0

    @cached_property
    def mean_burst(self) -> float:
        """Mean number of messages lost in a row; 0 if none was."""
        bursts, before = 0, None
        for each in self.crossings:
            goes_on = before is not None and before.lost_by and each.sequence == before.sequence + 1
            bursts += bool(each.lost_by) and not goes_on
            before = each
        return sum(self.lost.values()) / bursts if bursts else 0.0

    @property
    def late(self) -> int:
        """Number of messages received after the end of their round, or after a newer one."""
        return int(self.per_step[:, 2].sum())

    @property
    def duplicates(self) -> int:
        """Number of copies of messages that had been received before."""
        return sum(each.copies for each in self.crossings)

    def latency(self, probability: float) -> float | None:
        """Return a quantile of the latencies, s; None if there are none."""
        return float(np.quantile(self.latencies, probability)) if self.latencies.size else None

    @property
    def profile(self) -> LinkProfile | None:
        """Profile of the link; None if no latency was recorded."""
        if not self.latencies.size:
            return None
        quantiles = np.quantile(self.latencies, np.linspace(0, 1, _QUANTILES))
        return LinkProfile(
            sender=self.sender,
            receiver=self.receiver,
            messages=self.sent,
            lost=sum(self.lost.values()),
            mean_burst=self.mean_burst,
            latency=tuple(np.maximum.accumulate(quantiles).tolist()),  # interpolation can descend in the last bit
            offset_error=self.clock_error or 0.0,
        )


def link_health(run: Run) -> tuple[LinkHealth, ...]:
    """Return the measurements of all links of `run`, ascending by sender, then receiver."""
    found = [
        _health(log, sender, nanoseconds(run.fleet.time.sample_time), wall=run.fleet.time.clock == "wall")
        for log in run.agents.values()
        for sender in log.links
    ]
    return tuple(sorted(found, key=lambda each: (each.sender, each.receiver)))


def _health(log: AgentLog, sender: int, sample_time: int, *, wall: bool) -> LinkHealth:
    crossings = tuple(_crossings(log, sender, wall=wall))
    if wall:
        crossings = tuple(each._replace(waited=_waited(each.due, log, sample_time)) for each in crossings)
    received, missing, late, lost = log.links[sender].T
    recorded = wall or bool(crossings)
    steps = max([int(log.step[-1]), *(each.step for each in crossings)]) + 1
    per_step = np.zeros((steps, 3), dtype=np.int64)
    np.add.at(per_step[:, 2], log.step, late)
    if not recorded:
        np.add.at(per_step[:, 0], log.step, received + late + lost)
    for each in crossings:
        per_step[each.step, 0] += 1
        per_step[each.step, 1] += bool(each.lost_by)
    came = [each for each in crossings if not each.lost_by]
    latencies = [each.latency for each in crossings if each.latency is not None]
    first, last = int(log.step[0]) * sample_time * 1e-9, float(log.acted[-1])  # equal to sensed after a crash
    instants = np.sort([first, *(each.due * 1e-9 for each in came if first < each.due * 1e-9 < last), last])
    ahead, error = _clock(log, sender) if wall else (None, None)
    return LinkHealth(
        sender=sender,
        receiver=log.agent,
        recorded=recorded,
        crossings=crossings,
        per_step=per_step,
        missing=int(missing.sum()),
        latencies=read_only(np.sort(latencies)),
        longest_gap=float(np.diff(instants).max()) if recorded else None,
        clock_ahead=ahead,
        clock_error=error,
    )


def _crossings(log: AgentLog, sender: int, *, wall: bool) -> Iterator[Crossing]:
    """Yield the messages of `sender` in the order of sending, including those that the network lost."""
    away = absences(log)
    before: Crossing | None = None
    for each in log.passed:
        if each.sender != sender:
            continue
        if before is not None and each.sequence == before.sequence and each.entered == before.entered:
            due = min(before.due, each.due)  # a copy
            before = before._replace(due=due, copies=before.copies + 1)
            continue
        if before is not None:
            yield before
        after = Crossing(each.sequence, each.step, each.round, each.lost_by, each.entered, each.due)
        there = before is not None and not any(before.step <= step <= after.step for step in away)
        if wall and before is not None and there:
            yield from _gap(before, after)
        before = after
    if before is not None:
        yield before


def _gap(before: Crossing, after: Crossing) -> Iterator[Crossing]:
    """Yield the lost messages between two others; one round has one sequence number.

    There are none where the sender was restarted, or where there was no time for them: then the log is damaged and a
    number is wrong.
    """
    if (after.sequence - before.sequence) * _LEAST > after.entered - before.entered + _SLACK:
        return
    for sequence in range(before.sequence + 1, after.sequence):
        round = after.round - (after.sequence - sequence)
        step = after.step
        if round < 0:
            step, round = before.step, before.round + sequence - before.sequence
        yield Crossing(sequence, step, round, NETWORK, -1, -1)


def absences(log: AgentLog) -> tuple[int, ...]:
    """Return the steps up to the last one in a log in which its agent took no part: it was down, or only held."""
    if not len(log.step):
        return ()
    took_part = {int(step) for step, word in zip(log.step, log.stopped_by, strict=True) if word != "abstained"}
    return tuple(step for step in range(int(log.step[-1]) + 1) if step not in took_part)


def _waited(due: int, log: AgentLog, sample_time: int) -> bool:
    """Return whether a message was read between the nominal begin of a step and sensing: before, the loop slept."""
    row = int(np.searchsorted(log.sensed, due * 1e-9 - 5e-10))
    return row < len(log.step) and due >= int(log.step[row]) * sample_time


def _clock(log: AgentLog, sender: int) -> tuple[float, float] | tuple[None, None]:
    known = log.header.get("clock_offsets", {}).get(sender)
    return (None, None) if known is None else (known[0] * 1e-9, known[1] * 1e-9)


def total_per_step(health: tuple[LinkHealth, ...]) -> npt.NDArray[np.int64]:
    """Return `LinkHealth.per_step` of all links, shape (L, K, 3); 0 after the end of a receiver's log."""
    table = np.zeros((len(health), max((len(each.per_step) for each in health), default=0), 3), dtype=np.int64)
    for row, each in zip(table, health, strict=True):
        row[: len(each.per_step)] = each.per_step
    return table
