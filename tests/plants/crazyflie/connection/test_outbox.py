"""All that is sent to a Crazyflie: with cflib's own object, and a driver that keeps what it gets."""

import threading
from collections.abc import Iterator
from typing import Any

import pytest
from cflib.crazyflie import Crazyflie
from cflib.crtp.crtpdriver import CRTPDriver
from cflib.crtp.crtpstack import CRTPPacket

from plants.crazyflie.connection.outbox import Outbox
from tests.support.waiting import until

pytestmark = pytest.mark.real_time


class Driver(CRTPDriver):  # type: ignore[misc]
    """Keeps packets; fails on demand."""

    def __init__(self) -> None:
        self.needs_resending = False
        self.sent: list[bytes] = []
        self.problem = ""

    def send_packet(self, packet: Any) -> None:
        if self.problem:
            raise OSError(self.problem)
        self.sent.append(bytes(packet.data))


@pytest.fixture
def driver() -> Driver:
    return Driver()


@pytest.fixture
def crazyflie(driver: Driver) -> Any:
    made = Crazyflie()
    made.link = driver
    return made


@pytest.fixture
def outbox(crazyflie: Any) -> Iterator[Outbox]:
    made = Outbox(crazyflie, always_resend=True)
    made.start()
    yield made
    made.close()


def packet(*data: int, port: int = 5, channel: int = 1) -> Any:
    made = CRTPPacket()
    made.set_header(port, channel)
    made.data = data
    return made


def test_what_is_not_answered_is_sent_again_until_it_is(outbox: Outbox, driver: Driver, crazyflie: Any) -> None:
    crazyflie.send_packet(packet(1, 2), expected_reply=(1, 2), timeout=0.1)
    until(lambda: len(driver.sent) >= 3, "it is sent three times", within=3.0)
    crazyflie.packet_received.call(packet(1, 2, 0))
    assert outbox._pending == {}


def test_where_no_answer_is_expected_it_is_sent_once(outbox: Outbox, driver: Driver) -> None:
    outbox.send_packet(packet(7))
    outbox.send_packet(packet(8), expected_reply=(8,), timeout=0.1)
    until(lambda: driver.sent.count(b"\x08") >= 2, "the other is sent again", within=3.0)
    assert driver.sent.count(b"\x07") == 1


def test_a_driver_that_sends_again_by_itself_is_left_to_it(driver: Driver, crazyflie: Any) -> None:
    outbox = Outbox(crazyflie, always_resend=False)
    outbox.send_packet(packet(8), expected_reply=(8,), timeout=0.1)
    assert outbox._pending == {}
    driver.needs_resending = True
    outbox.send_packet(packet(8), expected_reply=(8,), timeout=0.1)
    assert len(outbox._pending) == 1


def test_an_answer_belongs_to_the_question_with_most_in_common(outbox: Outbox, crazyflie: Any) -> None:
    outbox.send_packet(packet(1), expected_reply=(1,), timeout=60.0)
    outbox.send_packet(packet(1, 2), expected_reply=(1, 2), timeout=60.0)
    crazyflie.packet_received.call(packet(1, 2, 3))
    assert [bytes(each.packet.data) for each in outbox._pending.values()] == [b"\x01"]
    crazyflie.packet_received.call(packet(1, 2, 3, channel=0))
    assert len(outbox._pending) == 1


def test_a_driver_that_fails_holds_nobody_up(outbox: Outbox, driver: Driver) -> None:
    driver.problem = "unplugged"
    outbox.send_packet(packet(1))
    assert outbox.failure == "sending failed: unplugged"
    others = [threading.Thread(target=outbox.send_packet, args=(packet(2),), daemon=True) for _ in range(3)]
    for each in others:
        each.start()
    for each in others:
        each.join(1.0)
        assert not each.is_alive()


def test_without_a_link_nothing_happens(outbox: Outbox, driver: Driver, crazyflie: Any) -> None:
    crazyflie.link = None
    outbox.send_packet(packet(1), expected_reply=(1,))
    crazyflie.link = driver
    outbox.close()
    outbox.send_packet(packet(1))
    assert driver.sent == []
