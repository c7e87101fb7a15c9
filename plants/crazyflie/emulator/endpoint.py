"""Sockets for clients of a drone: a UDP port, or a TCP port with CPX frames."""

import contextlib
import socket
import struct
import time
from abc import ABC, abstractmethod

from plants.crazyflie.emulator.crtp import DATA_MAX, NULL

STAMPED = getattr(socket, "SO_TIMESTAMPNS", 35)  # Linux time stamps: instants of reception even in a busy process
ROOM = 64  # bytes for a datagram
DRONE, HOST, CRTP = 1, 3, 3  # CPX: addresses of the drone's processor and of the client; function of a frame
FRAME_MAX = 1024


class Endpoint(ABC):
    """Socket for one client at a time, the newest."""

    @property
    @abstractmethod
    def uri(self) -> str:
        """URI for clients."""

    @abstractmethod
    def open(self) -> None:
        """Open the port. Safe to call twice.

        Raises:
            OSError: The port is taken.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the port. Safe to call twice."""

    def lose(self) -> None:
        """Make the loss of the link visible to the client, if possible, until `open` is called."""

    @abstractmethod
    def sockets(self) -> list[socket.socket]:
        """Return the sockets to wait for."""

    @abstractmethod
    def receive(self) -> list[tuple[float, bytes]]:
        """Return all received packets, each with its instant of the monotonic clock, s."""

    @abstractmethod
    def send(self, wire: bytes) -> None:
        """Send a packet to the client, if there is one."""


class Udp(Endpoint):
    """UDP port: one datagram is one packet. The client is the last sender.

    Args:
        host: Address to listen on.
        port: Port to listen on; 0 takes a free one.
    """

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None
        self._client: tuple[str, int] | None = None

    @property
    def uri(self) -> str:
        """URI for clients."""
        return f"udp://{self._address[0]}:{self._address[1]}"

    def open(self) -> None:
        """Open the port."""
        if self._socket is not None:
            return
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            made.setblocking(False)
            with contextlib.suppress(OSError):
                made.setsockopt(socket.SOL_SOCKET, STAMPED, 1)
            made.bind(self._address)
        except OSError:
            made.close()
            raise
        self._socket, self._address = made, made.getsockname()

    def close(self) -> None:
        """Close the port."""
        if self._socket is not None:
            self._socket.close()
        self._socket = self._client = None

    def lose(self) -> None:
        """Close the port: a client that sends then gets an error from the operating system."""
        self.close()

    def sockets(self) -> list[socket.socket]:
        """Return the socket, if the port is open."""
        return [] if self._socket is None else [self._socket]

    def receive(self) -> list[tuple[float, bytes]]:
        """Return all received datagrams. Probes are answered immediately."""
        received = []
        while self._socket is not None:
            try:
                wire, ancillary, _, sender = self._socket.recvmsg(ROOM, ROOM)
            except BlockingIOError:
                break
            except ConnectionError:  # the client has gone
                continue
            if wire and wire[0] == NULL:
                with contextlib.suppress(OSError):
                    self._socket.sendto(wire, sender)
                continue
            self._client = sender
            received.append((_instant(ancillary), wire))
        return received

    def send(self, wire: bytes) -> None:
        """Send a datagram; it is lost if the client has gone."""
        if self._socket is not None and self._client is not None:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self._socket.sendto(wire, self._client)


class Tcp(Endpoint):
    """TCP port with CPX frames: two bytes for the length of the rest, one for the addresses, the function, the packet.

    A lost link only falls silent: when the peer closes the connection, the reading thread of cflib 0.1.34 spins.

    Args:
        host: Address to listen on.
        port: Port to listen on; 0 takes a free one.
    """

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._listening: socket.socket | None = None
        self._client: socket.socket | None = None
        self._received, self._outgoing = bytearray(), bytearray()

    @property
    def uri(self) -> str:
        """URI for clients."""
        return f"tcp://{self._address[0]}:{self._address[1]}"

    def open(self) -> None:
        """Open the port."""
        if self._listening is not None:
            return
        self._listening = socket.create_server(self._address)
        self._listening.setblocking(False)
        self._address = self._listening.getsockname()

    def close(self) -> None:
        """Close the port and the connection."""
        for each in (self._listening, self._client):
            if each is not None:
                each.close()
        self._listening = self._client = None

    def sockets(self) -> list[socket.socket]:
        """Return the listening socket and the client's."""
        return [each for each in (self._listening, self._client) if each is not None]

    def receive(self) -> list[tuple[float, bytes]]:
        """Return all packets in complete frames; frames with another function are dropped."""
        self._accept()
        while self._client is not None:
            try:
                data = self._client.recv(4096)
            except BlockingIOError:
                break
            except ConnectionError:
                data = b""
            if not data:
                self._client.close()
                self._client = None
            self._received += data
        packets, now = [], time.monotonic()
        while len(self._received) >= 2:
            (length,) = struct.unpack_from("<H", self._received)
            if length > FRAME_MAX:  # frame boundaries are lost for good
                self._received.clear()
            if len(self._received) < 2 + length:
                break
            frame = bytes(self._received[2 : 2 + length])
            del self._received[: 2 + length]
            if len(frame) > 2 and frame[1] & 0x3F == CRTP:
                packets.append((now, frame[2 : 3 + 2 + DATA_MAX]))
        return packets

    def send(self, wire: bytes) -> None:
        """Send a frame; bytes that do not fit into the socket's buffer wait for the next call."""
        if self._client is None:
            return
        self._outgoing += struct.pack("<HBB", 2 + len(wire), DRONE << 3 | HOST, CRTP) + wire
        try:
            sent = self._client.send(self._outgoing)
        except BlockingIOError:
            return
        except ConnectionError:
            sent = len(self._outgoing)
        del self._outgoing[:sent]

    def _accept(self) -> None:
        """Accept a new client, in place of the last."""
        with contextlib.suppress(BlockingIOError):
            if self._listening is not None:
                client, _ = self._listening.accept()
                if self._client is not None:
                    self._client.close()
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._client = client
                self._received.clear()
                self._outgoing.clear()


def _instant(ancillary: list[tuple[int, int, bytes]]) -> float:
    """Return the instant of reception on the monotonic clock, s, from the system's time stamp if there is one."""
    now = time.monotonic()
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == STAMPED and len(data) >= 16:
            seconds, nanoseconds = struct.unpack("qq", data[:16])
            age: float = time.time() - (seconds + nanoseconds * 1e-9)
            return now - max(0.0, age)
    return now
