"""Progress of a sweep, on standard error."""

import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from agentd.launcher.progress import LINE_PERIOD


class SweepProgress:
    """Shows progress as a bar on a terminal, elsewhere as a line every `LINE_PERIOD`.

    Args:
        total: Number of runs.
        finished: Number of runs that were finished before.
        quiet: Print messages only.
    """

    def __init__(self, total: int, finished: int, *, quiet: bool) -> None:
        self._console = Console(stderr=True)
        self._total, self._finished, self._before = total, finished, finished
        self._lines = not (quiet or self._console.is_terminal)
        self._began = self._last_line = time.monotonic()
        self._bar = Progress(
            TextColumn("runs"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left:"),
            TimeRemainingColumn(), console=self._console, transient=True,
            disable=quiet or not self._console.is_terminal,
        )  # fmt: skip
        self._task = self._bar.add_task("runs", total=total, completed=finished)

    def __enter__(self) -> Self:
        self._bar.start()
        if self._lines and self._finished:
            self._console.print(f"{self._finished} of {self._total} runs were there already", highlight=False)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def message(self, line: str) -> None:
        """Print a line above the bar."""
        self._console.print(f"agentd: {line}", markup=False, highlight=False, soft_wrap=True)

    def run_finished(self) -> None:
        """Count one more finished run."""
        self._finished += 1
        self._bar.update(self._task, completed=self._finished)
        now = time.monotonic()
        if self._lines and (now - self._last_line >= LINE_PERIOD or self._finished == self._total):
            self._last_line = now
            left = (now - self._began) / (self._finished - self._before) * (self._total - self._finished)
            self._console.print(f"{self._finished} of {self._total} runs, about {left:.0f} s left", highlight=False)
