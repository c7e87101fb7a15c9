import random
import tracemalloc
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcf_zenoh.errors import MessageError
from dcf_zenoh.message import Last, Message
from dcf_zenoh.messaging.mailbox import AHEAD_MAX, GAP_MAX, RESTARTS_MAX, Limits, Mailbox
from dcf_zenoh.requests import NEVER


def message(sequence: int, step: int, round: int, last: Last = Last.NO) -> Message:
    return Message(2, 0, sequence, step, round, 10 * sequence, -1, -1, 0, last, (), (), {})


def stream() -> list[Message]:
    return [message(4 * step + round, step, round) for step in range(3) for round in range(4)]


def test_messages_are_released_in_the_order_of_their_numbers() -> None:
    for seed in range(20):
        mailbox, shuffled = Mailbox([2]), stream()
        random.Random(seed).shuffle(shuffled)
        for one in shuffled:
            mailbox.put(one, 0)
        assert [delivery.message for delivery in mailbox.take(2, 9, 9)] == stream()


def test_nothing_behind_a_gap_counts_as_received_or_is_released() -> None:
    mailbox = Mailbox([2])
    mailbox.put(message(0, 0, 0), 0)
    mailbox.put(message(2, 0, 2), 0)
    assert mailbox.has_received(2, 0, 0)
    assert not mailbox.has_received(2, 0, 1)
    assert mailbox.missing_from([2], 0, 1) == (2,)
    assert len(mailbox.take(2, 0, 2)) == 1
    mailbox.skip_gaps()
    assert mailbox.has_received(2, 0, 2)
    assert mailbox.missing == 1
    mailbox.put(message(1, 0, 1), 0)  # too late now, but not lost
    assert (mailbox.missing, mailbox.overtaken, mailbox.duplicates) == (0, 1, 0)


def test_taking_stops_at_the_receivers_present() -> None:
    mailbox = Mailbox([2])
    for one in stream():
        mailbox.put(one, 0)
    assert [d.message.round for d in mailbox.take(2, 0, 1)] == [0, 1]
    assert [d.message.round for d in mailbox.take(2, 0, 1)] == []
    assert [(d.message.step, d.message.round) for d in mailbox.take(2, 1, 0)] == [(0, 2), (0, 3), (1, 0)]


def test_repeated_messages_are_dropped_and_counted() -> None:
    mailbox = Mailbox([2])
    for number in (0, 0, 2, 2, 1, 1):
        mailbox.put(message(number, 0, number), 0)
    assert [d.message.sequence for d in mailbox.take(2, 9, 9)] == [0, 1, 2]
    assert mailbox.duplicates == 3


def test_last_message_of_a_step_counts_for_all_later_rounds_of_it() -> None:
    mailbox = Mailbox([2])
    mailbox.put(message(0, 5, 3, Last.OF_STEP), 0)
    assert mailbox.has_received(2, 5, NEVER)
    assert not mailbox.has_received(2, 6, 0)


def test_goodbye_counts_for_all_rounds_and_is_released_in_order() -> None:
    mailbox = Mailbox([2])
    mailbox.put(message(0, 5, 0), 0)
    assert mailbox.departed(2) is Last.NO
    mailbox.put(message(1, 6, 0, Last.ARRIVED), 0)
    assert mailbox.departed(2) is Last.ARRIVED
    assert mailbox.has_received(2, 1000, 1000)
    assert len(mailbox.take(2, 5, 9)) == 1
    assert [d.message.last for d in mailbox.take(2, 6, 0)] == [Last.ARRIVED]


def flight(steps: int, rounds: int = 4, begin: int = 0) -> list[Message]:
    """Return the messages of a sender from step `begin` on, numbered through from 0."""
    return [message(rounds * step + round, step, round) for step in range(begin, steps) for round in range(rounds)]


def received(mailbox: Mailbox, messages: Iterable[Message]) -> list[Message]:
    """Put in messages, each with a time-out after it, and return what is released at its step and round."""
    found = []
    for each in messages:
        with suppress(MessageError):
            mailbox.put(each, 0)
        mailbox.skip_gaps()
        found += [delivery.message for delivery in mailbox.take(2, each.step, each.round)]
    return found


def test_gap_beyond_its_bound_is_refused_and_one_within_costs_nothing() -> None:
    mailbox = Mailbox([2])
    mailbox.put(message(0, 0, 0), 0)
    for number in (GAP_MAX + 2, 2**53):
        with pytest.raises(MessageError, match=rf"sequence number {number} is {number - 1} after the one expected"):
            mailbox.put(message(number, 0, 1), 0)
    tracemalloc.start()
    try:
        mailbox.put(message(GAP_MAX + 1, 0, 1), 0)
        mailbox.skip_gaps()
        assert tracemalloc.get_traced_memory()[1] < 10_000
    finally:
        tracemalloc.stop()
    assert mailbox.missing == GAP_MAX
    for number in (7, GAP_MAX, 1, 7):
        assert not mailbox.put(message(number, 0, 0), 0)
    assert (mailbox.missing, mailbox.overtaken, mailbox.duplicates) == (GAP_MAX - 3, 3, 1)


@given(st.sets(st.integers(1, 40)), st.permutations(range(1, 41)))
def test_every_number_that_is_given_up_counts_once(lost: set[int], late: list[int]) -> None:
    mailbox = Mailbox([2])
    for number in range(42):
        if number not in lost:
            mailbox.put(message(number, number, 0), 0)
            mailbox.skip_gaps()
    assert mailbox.missing == len(lost)
    for number in late:
        mailbox.put(message(number, number, 0), 0)
    assert (mailbox.missing, mailbox.overtaken, mailbox.duplicates) == (0, len(lost), 40 - len(lost))


def test_messages_that_wait_behind_a_gap_are_bounded() -> None:
    mailbox = Mailbox([2])
    for number in range(1, AHEAD_MAX + 1):
        mailbox.put(message(number, 0, 0), 0)
    with pytest.raises(MessageError, match="4096 messages are waiting for number 0"):
        mailbox.put(message(AHEAD_MAX + 1, 0, 0), 0)
    mailbox.put(message(0, 0, 0), 0)
    assert len(mailbox.take(2, 0, 0)) == AHEAD_MAX + 1


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"step": 11}, "step 11: expected at most 10"),
        ({"step": NEVER}, f"step {NEVER}: expected at most 10"),
        ({"round": 6}, "round 6: expected at most 5"),
        ({"incarnation": 1}, "incarnation 1 without a hello of it; expected 0, as this sender lives"),
    ],
)
def test_what_the_fleet_cannot_send_is_refused_and_changes_nothing(fields: dict[str, Any], text: str) -> None:
    mailbox = Mailbox([2], limits=Limits(10, 5))
    with pytest.raises(MessageError, match=text):
        mailbox.put(message(0, 0, 0)._replace(**fields), 0)
    assert received(mailbox, flight(3)) == flight(3)
    assert (mailbox.missing, mailbox.overtaken, mailbox.duplicates) == (0, 0, 0)


def test_restarted_sender_is_accepted_after_its_hello_its_death_or_its_goodbye() -> None:
    def restarted(number: int) -> Message:
        return message(0, 5, 0)._replace(incarnation=number)

    greeted, dead, gone = (Mailbox([2]) for _ in range(3))
    for mailbox in (greeted, dead, gone):
        received(mailbox, flight(2))
    greeted.greet(2, 1)
    dead.lost[2] = "its liveliness token is gone"
    gone.put(message(8, 2, 0, Last.FAILED), 0)
    for mailbox in (greeted, dead, gone):
        with pytest.raises(MessageError, match="incarnation 1002"):
            mailbox.put(restarted(RESTARTS_MAX + 2), 0)
        assert received(mailbox, [restarted(1)])[-1:] == [restarted(1)]
        assert not mailbox.dead(2)
    received(greeted, flight(3)[8:])  # after the restart, messages of before are overtaken
    assert greeted.overtaken > 0


FORGED = {
    "a number far ahead": message(5_000, 4, 1),
    "a step that has not begun": message(16, 6, 0),
    "a number and a step ahead": message(900, 6, 0),
    "a goodbye": message(16, 4, 0, Last.FAILED),
    "a goodbye far ahead": message(5_000, NEVER, 0, Last.LANDED),
    "the end of a step": message(16, 4, 3, Last.OF_STEP),
    "a promise without end": message(16, 4, 0)._replace(promise=NEVER),
    "another incarnation": message(0, 4, 1)._replace(incarnation=1),
    "another incarnation, with a hello": message(0, 4, 1)._replace(incarnation=1),
    "the last incarnation, with a hello": message(2**53, 6, 1)._replace(incarnation=2**20),
}


@pytest.mark.parametrize("name", FORGED)
def test_one_forged_message_costs_a_link_few_messages(name: str) -> None:
    mailbox, genuine = Mailbox([2]), flight(30)
    assert received(mailbox, genuine[:16]) == genuine[:16]
    if "hello" in name:
        mailbox.greet(2, FORGED[name].incarnation)
    received(mailbox, [FORGED[name]])
    found = received(mailbox, genuine[16:])
    assert found[-60:] == genuine[-60:] or found[-80:] == genuine[-80:]
    assert set(map(id, genuine[40:])) <= set(map(id, found))
    assert mailbox.departed(2) is Last.NO
    assert not mailbox.dead(2)
    assert mailbox.has_received(2, 29, 3)
    assert not mailbox.has_received(2, 30, 0)


def test_duplicates_and_late_messages_of_a_sound_link_never_begin_it_again() -> None:
    for seed in range(20):
        chance, mailbox, genuine = random.Random(seed), Mailbox([2]), flight(20)
        mixed = [each for each in genuine if chance.random() > 0.2 for _ in range(chance.choice((1, 1, 3)))]
        shuffled = sorted(mixed, key=lambda each: each.sequence + chance.uniform(0, 6))
        found = []
        for each in shuffled:
            mailbox.put(each, 0)
            if chance.random() < 0.3:
                mailbox.skip_gaps()
            found += [delivery.message for delivery in mailbox.take(2, NEVER, 0)]
        mailbox.skip_gaps()
        found += [delivery.message for delivery in mailbox.take(2, NEVER, 0)]
        numbers = [each.sequence for each in found]
        assert numbers == sorted(set(numbers))
        assert len(found) + mailbox.duplicates + mailbox.overtaken == len(shuffled)
