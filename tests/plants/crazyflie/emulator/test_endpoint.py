"""Ports: frames that come in pieces, clients that come and go."""

import select
import socket
import struct
import time
from collections.abc import Iterator

import pytest

from plants.crazyflie.emulator.endpoint import Endpoint, Tcp, Udp

pytestmark = pytest.mark.real_time

HOST = "127.0.0.1"


def come(endpoint: Endpoint, count: int) -> list[bytes]:
    """Wait until so many packets have come."""
    packets: list[bytes] = []
    end = time.monotonic() + 5.0
    while len(packets) < count:
        assert time.monotonic() < end, f"{count} packets expected, {packets} came"
        select.select(endpoint.sockets(), [], [], 0.1)
        packets += [wire for _, wire in endpoint.receive()]
    return packets


def frame(wire: bytes, function: int = 3) -> bytes:
    return struct.pack("<HBB", len(wire) + 2, 3 << 3 | 1, function) + wire


@pytest.fixture
def tcp() -> Iterator[Tcp]:
    made = Tcp(HOST, 0)
    made.open()
    yield made
    made.close()


@pytest.fixture
def udp() -> Iterator[Udp]:
    made = Udp(HOST, 0)
    made.open()
    yield made
    made.close()


def address(endpoint: Endpoint) -> tuple[str, int]:
    host, port = endpoint.uri.split("//")[1].split(":")
    return host, int(port)


def test_frames_are_found_however_they_come(tcp: Tcp) -> None:
    with socket.create_connection(address(tcp)) as client:
        sent = frame(b"\x01", function=1) + frame(b"one") + frame(b"two") + frame(b"three")
        for begin in range(0, len(sent), 5):
            client.sendall(sent[begin : begin + 5])
        assert come(tcp, 3) == [b"one", b"two", b"three"]
        tcp.send(b"back")
        assert client.recv(64) == struct.pack("<HBB", 6, 1 << 3 | 3, 3) + b"back"


def test_new_client_takes_the_place_of_the_last(tcp: Tcp) -> None:
    with socket.create_connection(address(tcp)) as first:
        first.sendall(frame(b"one") + b"\x07")  # and the beginning of another
        assert come(tcp, 1) == [b"one"]
        with socket.create_connection(address(tcp)) as second:
            second.sendall(frame(b"two"))
            assert come(tcp, 1) == [b"two"]
            assert first.recv(64) == b""
            tcp.send(b"x")
            assert second.recv(64)[-1:] == b"x"


def test_client_that_has_gone_does_no_harm(tcp: Tcp, udp: Udp) -> None:
    with socket.create_connection(address(tcp)) as client:
        client.sendall(frame(b"one"))
        assert come(tcp, 1) == [b"one"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.sendto(b"one", address(udp))
        assert come(udp, 1) == [b"one"]
    for _ in range(3):
        tcp.send(b"x")
        udp.send(b"x")
        assert tcp.receive() == udp.receive() == []


def test_datagram_bears_the_instant_at_which_it_came_not_that_of_reading(udp: Udp) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        before = time.monotonic()
        client.sendto(b"one", address(udp))
        sent = time.monotonic()
        select.select([], [], [], 0.2)
        ((came, _),) = udp.receive()
    assert before - 0.02 < came < sent + 0.05


def test_lost_link_is_an_error_at_the_client_until_it_is_open_again(udp: Udp) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.connect(address(udp))
        client.send(b"one")
        assert come(udp, 1) == [b"one"]
        udp.lose()
        client.send(b"two")
        client.settimeout(2.0)
        with pytest.raises(ConnectionRefusedError):
            client.recv(64)
        udp.open()
        client.send(b"three")
        assert come(udp, 1) == [b"three"]
