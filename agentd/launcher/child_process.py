"""Daemons as child processes: spawned, or forked by a server where that is possible."""

import ctypes
import errno
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType
from typing import IO, Protocol, Self

PYTHON_MODULE = (sys.executable, "-P", "-m")  # whatever lies in the working directory is not imported
FORKS_FROM = 3  # daemons from which on a server pays
ANSWER = 60.0  # s that the server has for a daemon, its own start included
POLL = 0.005  # s between two looks at a process that is to end
_CHILD_SUBREAPER = 36  # option of prctl


class ChildProcess(Protocol):
    """What the launcher needs of the process of a daemon; `subprocess.Popen` has it.

    Attributes:
        pid: Id of the process.
        stdin: Its standard input.
        stdout: Its standard output.
    """

    pid: int
    stdin: IO[str] | None
    stdout: IO[str] | None

    def poll(self) -> int | None:
        """Return the exit code, negative for a signal; None while the process runs."""

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; return the exit code.

        Raises:
            subprocess.TimeoutExpired: The process has not ended within `timeout` s.
        """

    def terminate(self) -> None:
        """Send SIGTERM, unless the process has ended."""

    def kill(self) -> None:
        """Send SIGKILL, unless the process has ended."""


class AdoptedProcess:
    """A process that a server has forked and this process has adopted; see `ChildProcess`."""

    def __init__(self, pid: int, stdin: IO[str], stdout: IO[str]) -> None:
        self.pid = pid
        self.stdin: IO[str] | None = stdin
        self.stdout: IO[str] | None = stdout
        self._code: int | None = None

    def poll(self) -> int | None:
        """Return the exit code, negative for a signal; None while the process runs."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; return the exit code."""
        until = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if until is not None and time.monotonic() >= until:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
            time.sleep(POLL)
        return code

    def terminate(self) -> None:
        """Send SIGTERM, unless the process has ended."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL, unless the process has ended."""
        self._send(signal.SIGKILL)

    def _send(self, number: int) -> None:
        if self.poll() is None:  # the id stays its own until `poll` has seen the end
            os.kill(self.pid, number)


class ProcessStarter:
    """Starts daemons: by a fork server for a fleet of `FORKS_FROM` or more, else one by one. Use it in a ``with``.

    With a server this process becomes, and stays, the parent of all orphans among its descendants.

    Args:
        count: Number of daemons that are to be started.
        modules: Modules that all of them need, in addition to those of `agentd`.
    """

    def __init__(self, count: int, modules: Sequence[str] = ()) -> None:
        self._server: subprocess.Popen[bytes] | None = None
        if count >= FORKS_FROM and _adopts_orphans():
            self._channel, theirs = socket.socketpair()
            self._channel.settimeout(ANSWER)
            command = [*PYTHON_MODULE, "agentd.launcher.fork_server", str(theirs.fileno()), *modules]
            with theirs:
                self._server = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    pass_fds=[theirs.fileno()],
                    start_new_session=True,
                )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the server, if there is one; the daemons that it has forked run on."""
        if self._server is not None:
            self._channel.close()
            self._server.kill()
            self._server.wait()
            self._server = None

    def start(self, arguments: Sequence[str], errors: IO[str]) -> ChildProcess:
        """Start `agentd` with `arguments`, in a session of its own so that Ctrl-C reaches the launcher alone.

        Args:
            arguments: Arguments of the command line.
            errors: File for its standard error.

        Raises:
            OSError: The process cannot be started.
        """
        if self._server is not None:
            try:
                return self._fork(arguments, errors)
            except TimeoutError:
                raise OSError(errno.ETIMEDOUT, f"the fork server has not answered for {ANSWER:g} s") from None
            except (OSError, ValueError):  # it has died
                self.close()
        return subprocess.Popen(
            [*PYTHON_MODULE, "agentd", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            start_new_session=True,
        )

    def _fork(self, arguments: Sequence[str], errors: IO[str]) -> AdoptedProcess:
        """Let the server fork a daemon.

        Raises:
            OSError: The server has ended, or does not answer.
            ValueError: It has ended before its answer.
        """
        theirs_in, ours_in = os.pipe()
        ours_out, theirs_out = os.pipe()
        stdin, stdout = os.fdopen(ours_in, "w", encoding="utf-8"), os.fdopen(ours_out, encoding="utf-8")
        try:
            request = json.dumps(arguments).encode()
            socket.send_fds(self._channel, [request], [theirs_in, theirs_out, errors.fileno()])
            pid = int(self._channel.recv(32))
        except BaseException:
            stdin.close()
            stdout.close()
            raise
        finally:
            os.close(theirs_in)
            os.close(theirs_out)
        return AdoptedProcess(pid, stdin, stdout)


def _adopts_orphans() -> bool:
    """Let this process adopt orphans among its descendants; return whether the system can do so."""
    if not sys.platform.startswith("linux"):
        return False
    with suppress(OSError, AttributeError):
        return bool(ctypes.CDLL(None).prctl(_CHILD_SUBREAPER, 1, 0, 0, 0) == 0)
    return False
