"""Relays between two agents on this machine: one that cuts TCP links and lets them back, one that loses datagrams."""

import random
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Self

SIZE = 1 << 16


class _Relay:
    """Relay in threads of its own, between whoever connects to `port` and the port `target`."""

    def __init__(self, kind: socket.SocketKind, target: int, port: int) -> None:
        self._target = ("127.0.0.1", target)
        self._closed = threading.Event()
        self._threads: list[threading.Thread] = []
        self._entrance = self._bound(kind, port)
        self.port: int = self._entrance.getsockname()[1]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closed.set()
        self._entrance.close()
        for thread in self._threads:
            thread.join(5.0)

    def _bound(self, kind: socket.SocketKind, port: int = 0) -> socket.socket:
        made = socket.socket(socket.AF_INET, kind)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(("127.0.0.1", port))
        made.settimeout(0.05)
        return made

    def _run(self, work: Callable[..., None], *arguments: object) -> None:
        thread = threading.Thread(target=work, args=arguments, daemon=True)
        self._threads.append(thread)
        thread.start()


class TcpRelay(_Relay):
    """Relay that can be stopped and started again: all links through it end, and can be opened anew."""

    def __init__(self, target: int, port: int = 0) -> None:
        super().__init__(socket.SOCK_STREAM, target, port)
        self._pairs: list[socket.socket] = []
        self.start()

    def start(self) -> None:
        """Accept connections, on the same port as before."""
        if self._entrance.fileno() < 0:
            self._entrance = self._bound(socket.SOCK_STREAM, self.port)
        self._entrance.listen()
        self._run(self._accept, self._entrance)

    def stop(self) -> None:
        """Refuse connections, and end those that there are."""
        self._entrance.close()
        while self._pairs:
            with suppress(OSError):
                self._pairs.pop().shutdown(socket.SHUT_RDWR)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        super().__exit__(kind, error, trace)

    def _accept(self, entrance: socket.socket) -> None:
        while not self._closed.is_set():
            try:
                near = entrance.accept()[0]
            except TimeoutError:
                continue
            except OSError:  # stopped
                return
            far = socket.socket()
            try:
                far.connect(self._target)
            except OSError:  # nobody listens there yet
                near.close()
                far.close()
                continue
            for end in (near, far):
                end.settimeout(None)
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._pairs += [near, far]
            self._run(self._pump, near, far)
            self._run(self._pump, far, near)

    def _pump(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(SIZE):
                sink.sendall(data)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)  # which ends the other direction too
        source.close()


class LossyUdpRelay(_Relay):
    """Relay that loses datagrams at random, both ways; for one client.

    Attributes:
        passed: Number of datagrams that have passed.
        lost: Number of those lost.
    """

    def __init__(self, target: int, loss: float, seed: int) -> None:
        super().__init__(socket.SOCK_DGRAM, target, 0)
        self._loss = loss
        self._random = random.Random(seed)
        self._client: tuple[str, int] | None = None
        self._exit = self._bound(socket.SOCK_DGRAM)
        self.passed = self.lost = 0
        self._run(self._forth)
        self._run(self._back)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        super().__exit__(kind, error, trace)
        self._exit.close()

    def _forth(self) -> None:
        while not self._closed.is_set():
            with suppress(OSError):
                data, self._client = self._entrance.recvfrom(SIZE)
                if self._passes():
                    self._exit.sendto(data, self._target)

    def _back(self) -> None:
        while not self._closed.is_set():
            with suppress(OSError):
                data, _ = self._exit.recvfrom(SIZE)
                if self._client and self._passes():
                    self._entrance.sendto(data, self._client)

    def _passes(self) -> bool:
        lost = self._random.random() < self._loss
        self.lost += lost
        self.passed += not lost
        return not lost
