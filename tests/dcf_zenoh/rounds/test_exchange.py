"""One agent's exchange, driven by hand: the test is its runner and its neighbours."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.algorithms.algorithm import Dialogue, Inbox, PerNeighbour
from dcf_zenoh.errors import AlgorithmError, NumericalError
from dcf_zenoh.faults.chain import ALWAYS, FaultChain, Layer
from dcf_zenoh.faults.tampering import Tampering
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.message import Last, Message, Payload
from dcf_zenoh.messaging.mailbox import Mailbox
from dcf_zenoh.requests import NEVER, Publish, Wait
from dcf_zenoh.rounds.exchange import ComputeTime, Exchange, ExchangeOptions, Outcome
from dcf_zenoh.rounds.receiver import NOT_FINITE, Receiver
from dcf_zenoh.rounds.sender import Sender
from dcf_zenoh.rounds.synchronous import Synchronous
from dcf_zenoh.spec import Rounds, nanoseconds

NEIGHBOURHOOD = Neighbourhood((2, 3), (2, 3), {1: 0.4, 2: 0.3, 3: 0.3}, 1, doubly_stochastic=True)
MS = 1_000_000


class Bench:
    """Agent 1 and a script for its neighbours 2 and 3.

    `answer(sender, round)` is what a neighbour sends in a round: its payload and the fleet time, in ns, at which it
    is received; None for nothing.
    """

    def __init__(self, answer: Callable[[int, int], tuple[Payload, int] | None], **settings: Any) -> None:
        self.mailbox = Mailbox(NEIGHBOURHOOD.receives_from)
        rounds = Rounds(**settings)
        self.receiver = receiver = Receiver(
            self.mailbox, hold=rounds.missing == "hold", skip_after_rounds=rounds.skip_after_rounds
        )
        options = ExchangeOptions(lambda: 0, compute_time=ComputeTime(nanoseconds(rounds.compute_time)))
        mode = Synchronous(rounds)
        self.exchange = Exchange(1, NEIGHBOURHOOD, rounds, self.mailbox, receiver, Sender(1), mode, options)
        self.answer = answer
        self.published: list[Publish] = []
        self.now = 0

    def run(self, dialogue: Dialogue[Any], *, until: int = NEVER, step: int = 0) -> Outcome[Any]:
        loop = self.exchange.negotiate(dialogue, step, self.now, until=until)
        reply: int | None = None
        while True:
            try:
                request = loop.send(reply)  # type: ignore[arg-type]
            except StopIteration as finished:
                outcome: Outcome[Any] = finished.value
                return outcome
            if isinstance(request, Publish):
                self.published.append(request)
            elif isinstance(request, Wait) and request.senders:
                for j in request.senders:
                    self._put(j, request)
                silent = self.mailbox.missing_from(request.senders, request.step, request.round)
                self.now = request.until if silent else self.now
            elif isinstance(request, Wait):
                self.now = max(self.now, request.until)
            reply = self.now

    def _put(self, sender: int, request: Wait) -> None:
        answer = self.answer(sender, request.round)
        if answer is not None:
            payload, due = answer
            sequence, residuals = 100 * request.step + request.round, (math.inf,)
            place = request.step, request.round
            message = Message(sender, 0, sequence, *place, 0, -1, -1, 0, Last.NO, residuals, (), payload)
            self.mailbox.put(message, due)
            self.mailbox.skip_gaps()


def listener(rounds: int, names: Callable[[int], str] = lambda _round: "x") -> Dialogue[list[Inbox]]:
    """Send round numbers for a number of rounds; return all inboxes."""
    seen: list[Inbox] = []
    for number in range(rounds):
        seen.append((yield {names(number): float(number)}, math.inf))
        if seen[-1].stop:
            break
    return seen


def test_round_ends_with_the_message_of_the_last_neighbour() -> None:
    bench = Bench(lambda j, p: ({"x": float(j)}, (10 * p + j) * MS))
    outcome = bench.run(listener(3))
    assert outcome.now == 23 * MS
    assert outcome.rounds == 3
    assert [sorted(inbox) for inbox in outcome.result] == [[2, 3]] * 3
    assert all(inbox.fresh(j) for inbox in outcome.result for j in (2, 3))


def test_algorithm_stops_when_it_is_out_of_rounds() -> None:
    bench = Bench(lambda j, p: ({"x": 0.0}, 0), max_rounds=4)
    outcome = bench.run(listener(99))
    assert (outcome.rounds, outcome.stopped_by) == (4, "rounds")
    assert [inbox.stop for inbox in outcome.result] == [False, False, False, True]


def test_algorithm_stops_when_it_is_out_of_time_and_the_neighbours_are_informed() -> None:
    bench = Bench(lambda j, p: ({"x": 0.0}, 10 * p * MS))
    outcome = bench.run(listener(99), until=35 * MS)
    assert outcome.stopped_by == "budget"
    assert outcome.now == 35 * MS
    assert outcome.rounds == 5
    assert [publish.message.last for publish in bench.published] == [Last.NO] * 5 + [Last.OF_STEP]


def test_late_message_counts_as_missing_then_as_late_and_is_held() -> None:
    # Agent 3 needs 15 ms for every message, a round ends after 10 ms.
    bench = Bench(lambda j, p: ({"x": 10.0 * j + p}, bench.now + (15 * MS if j == 3 else 0)), round_timeout=0.010)
    outcome = bench.run(listener(4))
    link = outcome.links[3]
    assert (link.received, link.missing, link.late) == (0, 4, 3)
    assert outcome.links[2].received == 4
    first, second, third, _ = outcome.result
    assert first.missing == (3,)
    assert second[3]["x"] == 30.0
    assert (second.age(3), second.fresh(3)) == (1, False)
    assert third[3]["x"] == 31.0


def test_absent_means_that_nothing_is_held() -> None:
    bench = Bench(
        lambda j, p: None if (j, p) == (3, 2) else ({"x": float(p)}, bench.now), round_timeout=0.01, missing="absent"
    )
    outcome = bench.run(listener(4))
    assert [inbox.missing for inbox in outcome.result] == [(), (), (3,), ()]


def test_held_payload_does_not_outlive_a_change_of_names() -> None:
    bench = Bench(lambda j, p: None if j == 3 and p else ({"state": 0.0}, bench.now), round_timeout=0.01)
    outcome = bench.run(listener(4, lambda number: "state" if number < 2 else "x"))
    assert [inbox.missing for inbox in outcome.result] == [(), (), (3,), (3,)]


def test_messages_of_an_earlier_step_never_enter_a_later_one() -> None:
    bench = Bench(lambda j, p: ({"x": 1.0}, bench.now + (15 * MS if j == 3 else 0)), round_timeout=0.010)
    bench.run(listener(2), step=0)
    bench.answer = lambda j, p: None if j == 3 else ({"x": 1.0}, bench.now)
    bench.now += 100 * MS
    outcome = bench.run(listener(2), step=1)
    assert [inbox.missing for inbox in outcome.result] == [(3,), (3,)]
    assert outcome.links[3].late == 1  # the second message of step 0


def test_compute_time_passes_once_per_round() -> None:
    bench = Bench(lambda j, p: ({"x": 0.0}, 0), compute_time=0.002)
    assert bench.run(listener(5)).now == 10 * MS


def test_edge_payloads_share_one_sequence_number() -> None:
    def dialogue() -> Dialogue[None]:
        yield PerNeighbour({2: {"x": 2.0}, 3: {}}), 1.0
        yield {"x": 1.0}, 1.0

    bench = Bench(lambda j, p: ({}, 0))
    bench.run(dialogue())
    sent = [(p.receiver, p.message.sequence, dict(p.message.payload)) for p in bench.published]
    assert sent == [(2, 0, {"x": 2.0}), (3, 0, {}), (None, 1, {"x": 1.0}), (None, 2, {})]
    assert bench.exchange.counts["published"] == 4


def test_own_payload_in_the_inbox_is_the_one_that_neighbours_receive() -> None:
    values = np.arange(4.0)

    def dialogue() -> Dialogue[Inbox]:
        inbox = yield {"x": values[::2]}, 1.0
        values[:] = 0.0
        return inbox

    own = Bench(lambda j, p: ({}, 0)).run(dialogue()).result.own["x"]
    np.testing.assert_array_equal(own, [0.0, 2.0])
    assert own.flags.c_contiguous


def yields(*said: Any) -> Dialogue[None]:
    while said:  # 'yield from' would hand the inbox to the tuple
        yield said[0]
        said = said[1:]


@pytest.mark.parametrize(
    ("said", "error", "text"),
    [
        ([{"x": 1.0}], AlgorithmError, r"agent 1: step 7 round 0: the algorithm yielded .*; expected a payload and a"),
        ([({"x": 1.0}, "big")], AlgorithmError, "expected a payload and a residual"),
        ([({"x": "text"}, 1.0)], AlgorithmError, "agent 1: step 7 round 0: payload 'x': expected an array or a number"),
        ([(None, 1.0)], AlgorithmError, "step 7 round 0: a payload is a mapping of names to .*, not NoneType"),
        (
            [({}, 1.0), ({}, math.nan)],
            NumericalError,
            "agent 1: step 7 round 1: the algorithm's residual is not a number; it diverges if a step size is too",
        ),
        ([({}, -1.0)], AlgorithmError, "step 7 round 0: the algorithm's residual is -1; expected a number >= 0"),
        ([(PerNeighbour({2: {}}), 1.0)], AlgorithmError, r"PerNeighbour names \[2\]; expected exactly .* \[2, 3\]"),
        ([({}, 1.0)] * 9, AlgorithmError, "agent 1: step 7 round 3: the algorithm went on after inbox.stop"),
    ],
)
def test_error_about_a_broken_contract_names_agent_step_and_round(
    said: list[Any], error: type[Exception], text: str
) -> None:
    bench = Bench(lambda j, p: ({}, 0), max_rounds=3)
    with pytest.raises(error, match=text):
        bench.run(yields(*said), step=7)


def test_silent_neighbour_is_lost_by_the_age_of_its_messages() -> None:
    bench = Bench(lambda j, p: ({}, bench.now) if j == 2 else None, round_timeout=0.01)
    bench.now = 500 * MS
    bench.run(listener(1), step=3)
    assert list(bench.exchange.lost_neighbours(bench.now, 400 * MS)) == [3]
    assert bench.exchange.lost_neighbours(bench.now, 900 * MS) == {}
    bench.mailbox.lost[2] = "its liveliness token is gone"
    assert bench.exchange.lost_neighbours(bench.now, 900 * MS) == {2: "its liveliness token is gone"}


@pytest.mark.parametrize("edges", [False, True])
def test_payload_that_is_not_finite_fails_its_sender_and_is_never_sent(edges: bool) -> None:
    bench = Bench(lambda j, p: ({"x": 0.0}, 0))

    def diverging() -> Dialogue[Any]:
        for value in (1.0, math.nan):
            payload: Any = {"x": np.array([0.0, value])}
            yield PerNeighbour({2: payload, 3: payload}) if edges else payload, 1.0

    text = r"^agent 1: step 7 round 1: the algorithm's payload 'x' is not finite: nan at \[1\]; it diverges if"
    with pytest.raises(NumericalError, match=text):
        bench.run(diverging(), step=7)
    assert {publish.message.round for publish in bench.published} == {0}


def test_payload_that_faults_make_infinite_is_missing_counted_and_logged() -> None:
    bench = Bench(lambda j, p: ({"x": 1e300 if p == 1 else 1.0}, 0), missing="absent", round_timeout=0.01)
    faults = FaultChain(0, 3, 1, [Layer("wrong", [(ALWAYS, Tampering(scale=1e10))])])
    bench.receiver._links = {3: faults}
    outcome = bench.run(listener(3))
    assert [inbox.missing for inbox in outcome.result] == [(), (3,), ()]
    assert outcome.links[3].lost == 1
    assert [(each[3], each[6]) for each in outcome.passed if each[6]] == [(1, NOT_FINITE)]
    assert bench.mailbox.refused == 1


def test_goodbye_is_revoked_by_what_follows_it() -> None:
    answers = {1: Last.FAILED, 2: Last.LANDED}
    bench = Bench(lambda j, p: ({"x": float(p)}, 0))
    put = bench.mailbox.put

    def forged(message: Message, entered: int) -> bool:
        kind = answers.get(message.round, Last.NO) if message.sender == 3 else Last.NO
        return put(message._replace(last=kind), entered)

    bench.mailbox.put = forged  # type: ignore[method-assign, assignment]
    outcome = bench.run(listener(5))
    assert [3 in inbox and inbox.fresh(3) for inbox in outcome.result] == [True, False, False, True, True]
    assert bench.exchange.lost_neighbours(0, NEVER) == {}
    assert not bench.exchange.departed(Last.LANDED)


def test_known_position_is_the_newest_received_and_never_set_back_or_ahead() -> None:
    bench = Bench(lambda j, p: None, round_timeout=0.01, missing="hold")
    known = []
    for step, sequence, position in ((4, 1, (1.0, 0.0)), (2, 2, (9.0, 9.0)), (5, 3, (2.0, 0.0)), (7, 4, (9.0, 9.0))):
        message = Message(2, 0, sequence, step, 1, 0, -1, -1, 0, Last.NO, (math.inf,), (), {"x": 0.0})
        bench.mailbox.put(message._replace(position=position), bench.now)
        bench.mailbox.skip_gaps()
        bench.run(listener(1), step=6)
        known.append(bench.exchange.positions[2])
    assert known == [(4, (1.0, 0.0)), (4, (1.0, 0.0)), (5, (2.0, 0.0)), (5, (2.0, 0.0))]
