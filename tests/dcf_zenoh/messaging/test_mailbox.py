import random

from dcf_zenoh.message import Last, Message
from dcf_zenoh.messaging.mailbox import Mailbox
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
