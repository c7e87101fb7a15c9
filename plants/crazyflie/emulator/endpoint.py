"""Where a client reaches a drone: a UDP port, or a TCP port with frames of CPX."""

import contextlib
import socket
import struct
import time
from abc import ABC, abstractmethod

from plants.crazyflie.emulator.crtp import DATA_MAX, NULL

STAMPED = getattr(socket, "SO_TIMESTAMPNS", 35)  # Linux stamps what arrives, so that a busy process knows when it came
ROOM = 64  # bytes for a datagram
DRONE, HOST, CRTP = 1, 3, 3  # CPX: the drone's processor, the client, and what a frame is about
FRAME_MAX = 1024


class Endpoint(ABC):
    """What a client connects to; one client at a time, the newest."""

    @property
    @abstractmethod
    def uri(self) -> str:
        """What a client connects with."""

    @abstractmethod
    def open(self) -> None:
        """Be there for clients. Safe to call twice.

        Raises:
            OSError: The port is taken.
        """

    @abstractmethod
    def close(self) -> None:
        """Be gone. Safe to call twice."""

    def lose(self) -> None:
        """Let the client find out that the link is lost, where it can; `open` ends it."""

    @abstractmethod
    def sockets(self) -> list[socket.socket]:
        """What to wait for."""

    @abstractmethod
    def receive(self) -> list[tuple[float, bytes]]:
        """All packets that have come, with the instant of the monotonic clock, s."""

    @abstractmethod
    def send(self, wire: bytes) -> None:
        """Send a packet to the client, if there is one."""


class Udp(Endpoint):
    """One datagram is one packet. Who sends last is the client.

    Args:
        host: Own address.
        port: Own port; 0 takes a free one.
    """

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None
        self._client: tuple[str, int] | None = None

    @property
    def uri(self) -> str:
        """What a client connects with."""
        return f"udp://{self._address[0]}:{self._address[1]}"

    def open(self) -> None:
        """Take the port."""
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
        """Give the port back."""
        if self._socket is not None:
            self._socket.close()
        self._socket = self._client = None

    def lose(self) -> None:
        """Give the port back: the system tells a client that sends to it that nobody is there."""
        self.close()

    def sockets(self) -> list[socket.socket]:
        """The socket, if the port is taken."""
        return [] if self._socket is None else [self._socket]

    def receive(self) -> list[tuple[float, bytes]]:
        """All datagrams that have come. A question whether somebody is there is answered on the spot."""
        came = []
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
            came.append((_instant(ancillary), wire))
        return came

    def send(self, wire: bytes) -> None:
        """Send a datagram. If the client has gone, so is the packet."""
        if self._socket is not None and self._client is not None:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self._socket.sendto(wire, self._client)


class Tcp(Endpoint):
    """Packets in frames of CPX: the length of what follows in two bytes, who to whom, about what, and the packet.

    A lost link only falls silent: where the connection is closed on it, cflib 0.1.34 spins in its reading thread.

    Args:
        host: Own address.
        port: Own port; 0 takes a free one.
    """

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._listening: socket.socket | None = None
        self._client: socket.socket | None = None
        self._came, self._going = bytearray(), bytearray()

    @property
    def uri(self) -> str:
        """What a client connects with."""
        return f"tcp://{self._address[0]}:{self._address[1]}"

    def open(self) -> None:
        """Take the port."""
        if self._listening is not None:
            return
        self._listening = socket.create_server(self._address)
        self._listening.setblocking(False)
        self._address = self._listening.getsockname()

    def close(self) -> None:
        """Give the port back, and end the connection."""
        for each in (self._listening, self._client):
            if each is not None:
                each.close()
        self._listening = self._client = None

    def sockets(self) -> list[socket.socket]:
        """Where clients come in, and the one that is there."""
        return [each for each in (self._listening, self._client) if each is not None]

    def receive(self) -> list[tuple[float, bytes]]:
        """All packets in complete frames; frames about something else are dropped."""
        self._welcome()
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
            self._came += data
        packets, now = [], time.monotonic()
        while len(self._came) >= 2:
            (length,) = struct.unpack_from("<H", self._came)
            if length > FRAME_MAX:  # out of step: there is no way back into it
                self._came.clear()
            if len(self._came) < 2 + length:
                break
            frame = bytes(self._came[2 : 2 + length])
            del self._came[: 2 + length]
            if len(frame) > 2 and frame[1] & 0x3F == CRTP:
                packets.append((now, frame[2 : 3 + 2 + DATA_MAX]))
        return packets

    def send(self, wire: bytes) -> None:
        """Send a frame; what does not fit waits for the next."""
        if self._client is None:
            return
        self._going += struct.pack("<HBB", 2 + len(wire), DRONE << 3 | HOST, CRTP) + wire
        try:
            sent = self._client.send(self._going)
        except BlockingIOError:
            return
        except ConnectionError:
            sent = len(self._going)
        del self._going[:sent]

    def _welcome(self) -> None:
        """Take in a new client, in place of the last."""
        with contextlib.suppress(BlockingIOError):
            if self._listening is not None:
                client, _ = self._listening.accept()
                if self._client is not None:
                    self._client.close()
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._client = client
                self._came.clear()
                self._going.clear()


def _instant(ancillary: list[tuple[int, int, bytes]]) -> float:
    """The instant of the monotonic clock at which a datagram came, by the system's stamp if there is one."""
    now = time.monotonic()
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == STAMPED and len(data) >= 16:
            seconds, nanoseconds = struct.unpack("qq", data[:16])
            age: float = time.time() - (seconds + nanoseconds * 1e-9)
            return now - max(0.0, age)
    return now
