"""Output of a daemon that never holds its loop up: status lines, standard output and error, and the log.

A pipe that is not read, a stopped terminal or a disk that stalls must not stop a flying body. Lines that find no room
are dropped and counted; records of the log are kept until the disk takes them.
"""

import atexit
import io
import logging
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from math import inf
from typing import Any, BinaryIO

ROOM = 1 << 20  # characters of output, or
LOG_ROOM = 1 << 26  # bytes of the log, that wait for a stalled terminal or disk
LOG_PATIENCE = 0.02  # s that the loop waits for a record to be handed to the operating system
LOG_STALLED = 0.2  # s that the disk takes for a record from which on it counts as stalled
DRAIN = 1.0  # s that a process waits at its end for its last lines to be taken
LOG_DRAIN = 2.0  # s that it waits for its last records

logger = logging.getLogger(__name__)


class StatusPipe:
    """Pipe to the launcher. A line for which it has no room is dropped.

    Args:
        descriptor: File descriptor of the pipe, which becomes non-blocking.

    Attributes:
        dropped: Number of lines dropped so far.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._rest = b""  # of a line of which the pipe has taken a part
        self.dropped = 0
        with suppress(AttributeError, OSError):  # not on every system
            os.set_blocking(descriptor, False)

    def write(self, line: str) -> None:
        """Write a line.

        Raises:
            OSError: The reader has closed the pipe.
        """
        self._write(self._rest)
        if self._rest:
            self.dropped += 1
        else:
            self._write(line.encode() + b"\n", whole=True)

    def _write(self, data: bytes, *, whole: bool = False) -> None:
        try:
            written = os.write(self._descriptor, data) if data else 0
        except BlockingIOError:
            self.dropped += whole
            return
        self._rest = data[written:]


class BackgroundStream(io.TextIOBase):
    """Text stream whose lines another thread writes.

    Args:
        descriptor: File descriptor to which the thread writes. An error of writing drops what was to be written.

    Attributes:
        dropped: Number of lines dropped so far.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._changed = threading.Condition()  # guards what follows
        self._line = ""
        self._waiting: deque[str] = deque()
        self._length = 0  # characters that wait or are being written
        self._reported = 0
        self.dropped = 0
        threading.Thread(target=self._run, name=f"output-{descriptor}", daemon=True).start()

    def writable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._descriptor

    def isatty(self) -> bool:
        """Return whether the file descriptor belongs to a terminal."""
        return os.isatty(self._descriptor)

    def write(self, text: str) -> int:
        """Queue the lines of `text`; keep what follows the last one for the next call."""
        with self._changed:
            *lines, self._line = (self._line + text).split("\n")
            for line in lines:
                if self._length + len(line) < ROOM:
                    self._waiting.append(line)
                    self._length += len(line) + 1
                else:
                    self.dropped += 1
            self._changed.notify_all()
        return len(text)

    def drain(self, seconds: float = DRAIN) -> None:
        """Wait until all that was written is out, at most for `seconds`."""
        if self._line:
            self.write("\n")
        with self._changed:
            self._changed.wait_for(lambda: not self._length, seconds)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting)
                lines = [*self._waiting]
                self._waiting.clear()
                length = sum(len(line) + 1 for line in lines)
                if self.dropped > self._reported:
                    lines.append(f"agentd: {self.dropped - self._reported} lines were dropped here: nothing took them")
                    self._reported = self.dropped
            with suppress(OSError):  # disk full, terminal closed
                _write_all(self._descriptor, "".join(f"{line}\n" for line in lines).encode(errors="backslashreplace"))
            with self._changed:
                self._length -= length
                self._changed.notify_all()


def claim_stdout() -> StatusPipe:
    """Reserve standard output for status lines; other output, for example of plug-ins, goes to standard error."""
    pipe = StatusPipe(os.dup(1))
    os.dup2(2, 1)
    sys.stdout = sys.stderr  # unbuffered: output comes before the error that ends the process
    return pipe


def detach_output() -> None:
    """Make threads write standard output and error, log messages included, from now to the end of the process.

    A stream that replaces one of the process, as in tests, stays as it is.
    """
    streams: dict[int, BackgroundStream] = {}
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None or stream not in (sys.__stdout__, sys.__stderr__):
            continue
        with suppress(OSError):  # disk full, terminal closed
            stream.flush()
        descriptor = stream.fileno()
        if descriptor not in streams:
            streams[descriptor] = BackgroundStream(descriptor)
            atexit.register(streams[descriptor].drain)
        setattr(sys, name, streams[descriptor])
        for handler in logging.getLogger().handlers:
            if isinstance(handler, logging.StreamHandler) and handler.stream is stream:
                handler.setStream(streams[descriptor])


def drain_output() -> None:
    """Wait, not for long, until what was written to standard output and error is out."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, BackgroundStream):
            stream.drain()


class LogFile:
    """File of an agent's log. Another thread writes to it, so that neither a stalled nor a full disk ends a flight.

    A record is with the operating system when `write` returns, unless that takes longer than `LOG_PATIENCE`: then it
    waits in memory. After an error of the disk what follows is discarded, so that the log can be read up to there.

    Args:
        file: The file, open for writing, unbuffered.
        warn: Called with a line about a disk that stalls or fails, in any thread.

    Attributes:
        failure: Why records are missing; empty if none are.
        longest: Longest time that the disk took for a record, s.
    """

    def __init__(self, file: BinaryIO, warn: Callable[[str], None] = logger.warning) -> None:
        self._file = file
        self._warn = warn
        self._changed = threading.Condition()  # guards what follows
        self._waiting: deque[bytes] = deque()
        self._length = 0  # bytes that wait or are being written
        self._began = inf  # monotonic s, of what is being written
        self._slow = False
        self.failure = ""
        self.longest = 0.0
        threading.Thread(target=self._run, name="log", daemon=True).start()

    def write(self, data: bytes) -> int:
        """Hand over a record; return its length."""
        with self._changed:
            behind = bool(self._length)
            if self._length + len(data) > LOG_ROOM and not self.failure:
                self._fail(f"the disk is stalled, and {LOG_ROOM >> 20} MiB wait for it")
            if not self.failure:
                self._waiting.append(bytes(data))
                self._length += len(data)
                self._changed.notify_all()
            if not behind:
                self._changed.wait_for(lambda: not self._length, LOG_PATIENCE)
            stalled = not self._slow and time.monotonic() - self._began > LOG_STALLED
            self._slow = self._slow or stalled
        if stalled:
            self._warn(f"the disk takes longer than {LOG_STALLED:g} s for a record of the log; the agent goes on")
        return len(data)

    def close(self) -> None:
        """Wait until the disk has taken the last records, at most for `LOG_DRAIN`; say how long the longest took."""
        with self._changed:
            if not self._changed.wait_for(lambda: not self._length, LOG_DRAIN):
                self._fail(f"the disk is stalled: {self._length} bytes did not reach it within {LOG_DRAIN:g} s")
        if self._slow and not self.failure:
            self._warn(f"the disk took {self.longest:.2f} s for a record of the log at worst")

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting)
                data = self._waiting.popleft()
                began = self._began = time.monotonic()
            problem = ""
            try:
                _write_all(self._file.fileno(), data)
            except (OSError, ValueError) as error:
                problem = f"cannot write the log: {getattr(error, 'strerror', None) or error}"
            with self._changed:
                self.longest, self._began = max(self.longest, time.monotonic() - began), inf
                if problem:
                    self._fail(problem)
                self._length -= len(data)
                if self.failure:
                    self._waiting.clear()
                    self._length = 0
                self._changed.notify_all()

    def _fail(self, reason: str) -> None:
        if not self.failure:
            self.failure = reason
            self._warn(f"{reason}; the agent goes on without it")


def _write_all(descriptor: int, data: bytes) -> None:
    view: Any = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]
