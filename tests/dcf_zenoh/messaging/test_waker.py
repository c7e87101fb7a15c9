import random
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from queue import Empty, SimpleQueue

import pytest

from dcf_zenoh.messaging.waker import Waker

pytestmark = pytest.mark.real_time

PATIENCE = 5.0  # s after which a wake-up counts as missed


@contextmanager
def waker() -> Iterator[tuple[Waker, SimpleQueue[int]]]:
    """A waker, and the channel that it wakes."""
    channel: SimpleQueue[int] = SimpleQueue()
    subject = Waker(channel.put)
    try:
        yield subject, channel
    finally:
        subject.close()


def wait(subject: Waker, channel: SimpleQueue[int], deadline: float, target: int = 7) -> float:
    """Block as a reader does; return the s past the deadline when woken."""
    subject.arm(target, deadline)
    assert channel.get(timeout=PATIENCE) == target
    subject.disarm()
    return time.monotonic() - deadline


def test_reader_is_woken_at_its_deadline_and_not_before() -> None:
    with waker() as (subject, channel):
        late = [wait(subject, channel, time.monotonic() + 0.02, target) for target in range(20)]
    assert min(late) >= 0.0
    assert sorted(late)[10] < 0.02
    assert max(late) < 0.5


def test_deadline_in_the_past_wakes_at_once() -> None:
    with waker() as (subject, channel):
        began = time.monotonic()
        wait(subject, channel, began - 1.0)
        assert time.monotonic() - began < 0.5


def test_deadline_may_be_earlier_or_later_than_the_one_before() -> None:
    with waker() as (subject, channel):
        for ahead in (0.1, 0.01, 0.05, 0.01):
            subject.arm(1, time.monotonic() + 60.0)  # it ended before its deadline
            subject.disarm()
            assert 0.0 <= wait(subject, channel, time.monotonic() + ahead) < 0.5


def test_one_deadline_wakes_once() -> None:
    with waker() as (subject, channel):
        subject.arm(3, time.monotonic() + 0.02)
        assert channel.get(timeout=PATIENCE) == 3  # and the reader stays armed
        with pytest.raises(Empty):
            channel.get(timeout=0.1)


def test_reader_that_does_not_block_is_not_woken() -> None:
    with waker() as (subject, channel):
        subject.poke()
        subject.arm(3, time.monotonic() + 0.02)
        subject.disarm()
        subject.poke()
        with pytest.raises(Empty):
            channel.get(timeout=0.1)


def test_poke_from_another_thread_wakes_a_reader_without_deadline() -> None:
    with waker() as (subject, channel):
        subject.arm(4, inf)
        poker = threading.Thread(target=subject.poke)
        poker.start()
        assert channel.get(timeout=PATIENCE) == 4
        poker.join()
        subject.poke()  # it still blocks, so it is woken again
        assert channel.get(timeout=PATIENCE) == 4


def test_closing_ends_the_thread_also_while_a_reader_is_armed() -> None:
    with waker() as (subject, _):
        subject.arm(1, inf)
    assert not [thread for thread in threading.enumerate() if thread.name == "waker"]


@pytest.fixture
def restless() -> Iterator[None]:
    """Threads interrupt each other everywhere."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("restless")
def test_no_deadline_is_missed_however_waits_follow_each_other() -> None:
    chance = random.Random(3)
    with waker() as (subject, channel):
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            deadline = time.monotonic() + chance.choice((1e-5, 1e-4))
            subject.arm(1, deadline)
            moment = deadline + chance.uniform(-1e-4, 4e-4)
            while time.monotonic() < moment:  # a message then comes at about the time at which the thread looks
                pass
            subject.disarm()
            subject.arm(2, time.monotonic() + chance.choice((0.0, 1e-5, 1e-4, 1e-3)))
            while channel.get(timeout=PATIENCE) != 2:  # raises Empty if it is missed
                pass
            subject.disarm()


@pytest.mark.usefixtures("restless")
def test_no_wake_up_is_missed_however_deadlines_messages_and_pokes_fall() -> None:
    """For a second one thread blocks, with short deadlines and without; another sends it one thing at a time."""
    chance, luck = random.Random(1), random.Random(2)
    news: SimpleQueue[None] = SimpleQueue()
    noticed = threading.Semaphore(0)
    over = threading.Event()
    missed: list[str] = []

    def send() -> None:
        while not over.is_set():
            by_poke = luck.random() < 0.7
            if by_poke:
                news.put(None)
                subject.poke()
            else:
                channel.put(-1)  # a message
            if not noticed.acquire(timeout=PATIENCE):
                missed.append("poke" if by_poke else "message")
                return
            for _ in range(luck.choice((0, 10, 100, 1000))):  # some other moment of the reader's
                pass

    with waker() as (subject, channel):
        teller = threading.Thread(target=send)
        teller.start()
        waits = told = 0
        end = time.monotonic() + 1.0
        try:
            while time.monotonic() < end:
                waits += 1
                ahead = chance.choice((0.0, 1e-5, 1e-4, 1e-3, inf))
                subject.arm(waits, time.monotonic() + ahead)
                got = channel.get(timeout=2 * PATIENCE) if news.empty() else 0
                subject.disarm()
                if got == -1 or not news.empty():
                    told += 1
                    if got != -1:
                        news.get()
                    noticed.release()
        finally:
            over.set()
            noticed.release()
            teller.join()
    assert not missed
    assert waits > told > 200
