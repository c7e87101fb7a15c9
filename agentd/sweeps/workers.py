"""Tasks distributed over processes of this machine, which all end with the iteration over the results."""

import gc
import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Generic, TypeVar

from threadpoolctl import threadpool_limits

TERM = 0.5  # s between SIGTERM and SIGKILL
_SPAWN = multiprocessing.get_context("spawn")  # a fork would copy threads' locks and half-initialised libraries
T = TypeVar("T")
R = TypeVar("R")


class WorkerDied(RuntimeError):
    """A process ended while it worked on a task; the message says how."""


@dataclass
class _Worker(Generic[T]):
    """A worker process.

    Attributes:
        process: The process.
        pipe: Connection for tasks and results.
        task: Index of the task that the process works on; None if it is idle.
    """

    process: SpawnProcess
    pipe: Connection
    task: int | None = None

    @classmethod
    def start(cls, work: Callable[[T], Any]) -> "_Worker[T]":
        """Start a process that ignores SIGINT: a terminal sends it to all its processes, and the parent ends them."""
        ours, theirs = _SPAWN.Pipe()
        process = _SPAWN.Process(target=_serve, args=(work, theirs), daemon=True)
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited, so it holds from the first instruction on
        try:
            process.start()
        finally:
            signal.signal(signal.SIGINT, before)
        theirs.close()  # so that the pipe closes when the process ends
        return cls(process, ours)

    def assign(self, index: int, task: T) -> None:
        """Send a task to the process."""
        self.task = index
        with suppress(OSError):  # the process has died, which reading its result will show
            self.pipe.send(task)

    def exit_text(self) -> str:
        """Describe how the process ended."""
        self.process.join(TERM)
        code = self.process.exitcode
        if code is not None and code < 0:
            return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with exit code {code}"


def run_in_processes(
    work: Callable[[T], R], tasks: Sequence[T], processes: int
) -> Generator[tuple[int, R | WorkerDied]]:
    """Call `work` for every task in several processes; yield results in the order in which they are ready.

    All processes end when the generator ends or is closed, at most about `TERM` later. A process that dies is replaced.

    Args:
        work: A function of a module. It must not raise.
        tasks: Arguments for `work`. They are pickled.
        processes: Maximum number of processes.

    Yields:
        Index of the task, and its result; `WorkerDied` if its process ended before the result.
    """
    waiting = deque(enumerate(tasks))
    workers: list[_Worker[T]] = []
    try:
        for _ in range(min(processes, len(waiting))):
            workers.append(_Worker.start(work))
            workers[-1].assign(*waiting.popleft())
        while busy := [worker for worker in workers if worker.task is not None]:
            ready = wait([worker.pipe for worker in busy])
            for worker in (each for each in busy if each.pipe in ready):
                assert worker.task is not None
                index, worker.task = worker.task, None
                try:
                    result: R | WorkerDied = worker.pipe.recv()
                except (EOFError, OSError):
                    result = WorkerDied(worker.exit_text())
                    workers.remove(worker)
                    if waiting:
                        workers.append(worker := _Worker.start(work))
                if waiting:
                    worker.assign(*waiting.popleft())
                yield index, result
    finally:
        _end(workers)


def _end(workers: Sequence[_Worker[Any]]) -> None:
    for worker in workers:
        worker.process.terminate()
    for worker in workers:
        worker.process.join(TERM)
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
        worker.pipe.close()


def _serve(work: Callable[[T], Any], pipe: Connection) -> None:
    """Answer each task from the pipe with its result, until the pipe closes."""
    gc.freeze()  # so that the garbage collector skips everything imported
    with threadpool_limits(1):
        while True:
            try:
                task = pipe.recv()
            except (EOFError, OSError):
                return
            pipe.send(work(task))
