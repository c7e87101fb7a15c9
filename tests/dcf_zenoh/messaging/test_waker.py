import random
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from queue import Empty, SimpleQueue

import pytest

from dcf_zenoh.messaging.waker import Waker

PATIENCE = 5.0  # s after which a wake-up counts as missed


@contextmanager
def waker() -> Iterator[tuple[Waker, SimpleQueue[int]]]:
    """A waker, and the channel that it makes deliver something."""
    channel: SimpleQueue[int] = SimpleQueue()
    subject = Waker(channel.put)
    try:
        yield subject, channel
    finally:
        subject.close()


def wait(subject: Waker, channel: SimpleQueue[int], deadline: float, target: int = 7) -> float:
    """Block as a reader does; s past the deadline when woken."""
    subject.arm(target, deadline)
    assert channel.get(timeout=PATIENCE) == target
    subject.disarm()
    return time.monotonic() - deadline


def test_the_reader_is_woken_at_its_deadline_and_not_before() -> None:
    with waker() as (subject, channel):
        late = [wait(subject, channel, time.monotonic() + 0.02, target) for target in range(20)]
    assert min(late) >= 0.0
    assert sorted(late)[10] < 0.02
    assert max(late) < 0.5


def test_a_deadline_that_is_past_wakes_at_once() -> None:
    with waker() as (subject, channel):
        began = time.monotonic()
        wait(subject, channel, began - 1.0)
        assert time.monotonic() - began < 0.5


def test_a_deadline_may_be_earlier_or_later_than_the_one_before() -> None:
    with waker() as (subject, channel):
        for ahead in (0.1, 0.01, 0.05, 0.01):
            subject.arm(1, time.monotonic() + 60.0)  # and it came in time
            subject.disarm()
            assert 0.0 <= wait(subject, channel, time.monotonic() + ahead) < 0.5


def test_one_deadline_wakes_once() -> None:
    with waker() as (subject, channel):
        subject.arm(3, time.monotonic() + 0.02)
        assert channel.get(timeout=PATIENCE) == 3  # and the reader stays armed
        with pytest.raises(Empty):
            channel.get(timeout=0.1)


def test_who_does_not_block_is_not_woken() -> None:
    with waker() as (subject, channel):
        subject.poke()
        subject.arm(3, time.monotonic() + 0.02)
        subject.disarm()
        subject.poke()
        with pytest.raises(Empty):
            channel.get(timeout=0.1)


def test_a_poke_from_another_thread_wakes_whoever_waits_for_ever() -> None:
    with waker() as (subject, channel):
        subject.arm(4, inf)
        poker = threading.Thread(target=subject.poke)
        poker.start()
        assert channel.get(timeout=PATIENCE) == 4
        poker.join()
        subject.poke()  # it still blocks, so it is woken again
        assert channel.get(timeout=PATIENCE) == 4


def test_closing_ends_the_thread_also_while_somebody_is_armed() -> None:
    with waker() as (subject, _):
        subject.arm(1, inf)
    assert not [thread for thread in threading.enumerate() if thread.name == "waker"]


def test_no_wake_up_is_missed_however_deadlines_messages_and_pokes_fall() -> None:
    """For a second: a reader with short deadlines, a thread with news for it, and messages that end waits early."""
    chance = random.Random(1)
    news: SimpleQueue[float] = SimpleQueue()
    over = threading.Event()
    waits = woken_for_news = 0

    def tell() -> None:
        luck = random.Random(2)
        while not over.is_set():
            news.put(time.monotonic())
            subject.poke()
            if luck.random() < 0.3:
                channel.put(-1)  # a message
            over.wait(luck.choice((0.0, 1e-5, 1e-4, 1e-3)))

    with waker() as (subject, channel):
        teller = threading.Thread(target=tell)
        teller.start()
        try:
            end = time.monotonic() + 1.0
            while time.monotonic() < end:
                waits += 1
                patient = chance.random() < 0.5  # only news or a message end this wait
                subject.arm(waits, inf if patient else time.monotonic() + chance.choice((0.0, 1e-5, 1e-4, 1e-3)))
                if news.empty():
                    channel.get(timeout=PATIENCE)  # raises Empty if the wake-up was missed
                subject.disarm()
                while not news.empty():
                    news.get()
                    woken_for_news += 1
        finally:
            over.set()
            teller.join()
    assert waits > 500
    assert woken_for_news > 100
