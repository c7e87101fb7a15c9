"""Work spread over processes of this machine, which end when they are told to."""

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

TERM = 0.5  # s until a process that ignores SIGTERM is killed
_SPAWN = multiprocessing.get_context("spawn")  # not fork: there may be threads, and a parent's libraries half set up
T = TypeVar("T")
R = TypeVar("R")


class WorkerDied(RuntimeError):
    """A process ended in the middle of its work; the message says how."""


@dataclass
class _Worker(Generic[T]):
    """One process.

    Attributes:
        process: The process.
        line: To it and from it.
        task: Number of the task it is at; None: none.
    """

    process: SpawnProcess
    line: Connection
    task: int | None = None

    @classmethod
    def start(cls, work: Callable[[T], Any]) -> "_Worker[T]":
        """Start one that does not hear Ctrl-C, which goes to all processes of a terminal: its parent ends it."""
        ours, theirs = _SPAWN.Pipe()
        process = _SPAWN.Process(target=_serve, args=(work, theirs), daemon=True)
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # so from its first instruction on
        try:
            process.start()
        finally:
            signal.signal(signal.SIGINT, before)
        theirs.close()  # so that its end is the end of the line
        return cls(process, ours)

    def give(self, number: int, task: T) -> None:
        """Let it work."""
        self.task = number
        with suppress(OSError):  # it has died; its line will say so
            self.line.send(task)

    def how_it_ended(self) -> str:
        """In words."""
        self.process.join(TERM)
        code = self.process.exitcode
        if code is not None and code < 0:
            return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with exit code {code}"


def spread(work: Callable[[T], R], tasks: Sequence[T], processes: int) -> Generator[tuple[int, R | WorkerDied]]:
    """Do `work` for every task, in several processes; results in the order in which they come.

    However the iteration ends, with it all processes do, within `TERM` and a little.

    Args:
        work: A function of a module. It must not raise.
        tasks: What can be pickled.
        processes: How many, at most.

    Yields:
        Number of the task, and its result; `WorkerDied` if the process did not live to tell.
    """
    left = deque(enumerate(tasks))
    workers: list[_Worker[T]] = []
    try:
        for _ in range(min(processes, len(left))):
            workers.append(_Worker.start(work))
            workers[-1].give(*left.popleft())
        while busy := [worker for worker in workers if worker.task is not None]:
            ready = wait([worker.line for worker in busy])
            for worker in (each for each in busy if each.line in ready):
                assert worker.task is not None
                number, worker.task = worker.task, None
                try:
                    result: R | WorkerDied = worker.line.recv()
                except (EOFError, OSError):
                    result = WorkerDied(worker.how_it_ended())
                    workers.remove(worker)
                    if left:
                        workers.append(worker := _Worker.start(work))
                if left:
                    worker.give(*left.popleft())
                yield number, result
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
        worker.line.close()


def _serve(work: Callable[[T], Any], line: Connection) -> None:
    """Do what comes over the line until it closes."""
    gc.freeze()  # modules above all, which the collector need not look through again and again
    with threadpool_limits(1):
        while True:
            try:
                task = line.recv()
            except (EOFError, OSError):
                return
            line.send(work(task))
