"""How far a sweep is, on standard error."""

import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from agentd.launcher.progress import LINE_PERIOD


class SweepProgress:
    """A bar on a terminal, a line now and then elsewhere.

    Args:
        total: Runs of the sweep.
        done: Those that were there before.
        quiet: Say only what goes wrong.
    """

    def __init__(self, total: int, done: int, *, quiet: bool) -> None:
        self._console = Console(stderr=True)
        self._total, self._done, self._before = total, done, done
        self._lines = not (quiet or self._console.is_terminal)
        self._began = self._last_line = time.monotonic()
        self._bar = Progress(
            TextColumn("runs"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left:"),
            TimeRemainingColumn(), console=self._console, transient=True,
            disable=quiet or not self._console.is_terminal,
        )  # fmt: skip
        self._task = self._bar.add_task("runs", total=total, completed=done)

    def __enter__(self) -> Self:
        self._bar.start()
        if self._lines and self._done:
            self._console.print(f"{self._done} of {self._total} runs were there already", highlight=False)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def say(self, line: str) -> None:
        """Print a line that stays."""
        self._console.print(f"agentd: {line}", markup=False, highlight=False, soft_wrap=True)

    def done(self) -> None:
        """One run more."""
        self._done += 1
        self._bar.update(self._task, completed=self._done)
        now = time.monotonic()
        if self._lines and (now - self._last_line >= LINE_PERIOD or self._done == self._total):
            self._last_line = now
            left = (now - self._began) / (self._done - self._before) * (self._total - self._done)
            self._console.print(f"{self._done} of {self._total} runs, about {left:.0f} s left", highlight=False)
