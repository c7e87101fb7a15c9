"""Signals that would end a process: caught from anywhere in it, and turned into calls."""

import signal
import socket
import threading
import time
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Self

_FAULTS = "SIGABRT SIGBUS SIGEMT SIGFPE SIGILL SIGSEGV SIGSYS SIGTRAP"  # the process is broken: nothing can be done
_HARMLESS = "SIGCHLD SIGCLD SIGCONT SIGINFO SIGPIPE SIGURG SIGWINCH SIGXFSZ"  # ignored by the system or by Python
_STOPPING = "SIGTSTP SIGTTIN SIGTTOU"  # stop the process until SIGCONT
_UNCATCHABLE = "SIGKILL SIGSTOP"


def _numbers(names: str) -> frozenset[int]:
    return frozenset(int(getattr(signal, name)) for name in names.split() if hasattr(signal, name))


# All signals that end a process unless they are caught: SIGHUP, SIGINT, SIGQUIT, SIGTERM, real-time signals, ...
ENDING = frozenset(map(int, signal.valid_signals())) - _numbers(f"{_FAULTS} {_HARMLESS} {_STOPPING} {_UNCATCHABLE}")
CTRL_Z = _numbers("SIGTSTP")
TERMINAL = _numbers("SIGTTIN SIGTTOU")  # stop a process in the background that reads from or writes to its terminal


def signal_name(number: int) -> str:
    """Return the name of a signal, such as SIGTERM; real-time signals have none but the number."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


class CaughtSignals:
    """Signals of a process that must not end before it has landed its body. Use it in a ``with`` statement.

    A thread reads the numbers of the signals from a socket to which the interpreter writes them. So a signal is heard
    wherever the main thread is: in an import, in compiled code, waiting for a message, or in an endless loop. Signals
    that the process was started with as ignored stay so (``nohup``), other than SIGINT.

    Args:
        numbers: Signals that are caught.

    Attributes:
        number: First signal that was caught; None: none so far.
    """

    def __init__(self, numbers: frozenset[int]) -> None:
        self._numbers = numbers
        self._ignored = TERMINAL
        self.number: int | None = None
        self._since = 0.0  # monotonic s, of the first signal
        self._changed = threading.Condition()  # guards number, _since and _react
        self._react: Callable[[int], None] | None = None

    def __enter__(self) -> Self:
        self._receiving, self._sending = socket.socketpair()
        self._sending.setblocking(False)
        self._previous_socket = signal.set_wakeup_fd(self._sending.fileno(), warn_on_full_buffer=False)
        self._before = {}
        for number in sorted(self._numbers | self._ignored):
            handler = signal.getsignal(number)
            if handler in (signal.SIG_DFL, signal.default_int_handler) or number == signal.SIGINT:
                self._before[number] = handler
                signal.signal(number, signal.SIG_IGN if number in self._ignored else _heard)
        threading.Thread(target=self._read, name="signals", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._previous_socket)
        self._sending.close()  # ends the thread
        with self._changed:
            self._react = None

    def react(self, reaction: Callable[[int], None]) -> None:
        """Call `reaction` with the number of every signal, in another thread; at once if one was caught before."""
        with self._changed:
            self._react = reaction
            if self.number is not None:
                reaction(self.number)

    def end_within(self, seconds: Callable[[], float], overdue: Callable[[int], None]) -> None:
        """Limit the time from the first signal to the end of the process.

        Args:
            seconds: Returns the limit, in s; asked again until it has passed, since it may grow.
            overdue: Called with the number of the signal, in another thread, once the limit has passed.
        """

        def watch() -> None:
            with self._changed:
                self._changed.wait_for(lambda: self.number is not None)
            while (left := self._since + seconds() - time.monotonic()) > 0:
                time.sleep(min(left, 0.1))
            assert self.number is not None
            overdue(self.number)

        threading.Thread(target=watch, name="deadline-of-the-end", daemon=True).start()

    def _read(self) -> None:
        with self._receiving:
            while data := self._receiving.recv(64):
                for number in data:
                    if number in self._numbers:
                        self._take(number)

    def _take(self, number: int) -> None:
        with self._changed:
            if self.number is None:
                self.number, self._since = number, time.monotonic()
                self._changed.notify_all()
            if self._react is not None:
                self._react(number)


def _heard(_number: int, _frame: FrameType | None) -> None:
    """Do nothing: the thread of `CaughtSignals` reads the number."""
