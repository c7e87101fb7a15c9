"""Command lines of tests, and their answers."""

from typing import NamedTuple

QUICK = ("--json", "--no-report", "--set", "time.duration=1.0")  # a short run without figures


class Answer(NamedTuple):
    code: int
    out: str
    err: str
