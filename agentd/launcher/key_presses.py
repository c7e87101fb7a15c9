"""Single key presses on the terminal."""

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from agentd.daemon.stop_requests import in_foreground


class KeyPresses:
    """Key presses on standard input.

    Args:
        available: Whether there is a terminal to read from; without one no key is ever pressed.
    """

    def __init__(self, *, available: bool) -> None:
        self._available = available

    def next(self) -> str:
        """Return the next key in lower case, or an empty string if none is pressed. Does not wait."""
        if not self._available or not select.select([0], [], [], 0)[0]:
            return ""
        return os.read(0, 1).decode(errors="replace").lower()


@contextmanager
def reading_keys() -> Iterator[KeyPresses]:
    """Switch the terminal, within the context, to keys that are read without Enter and not echoed."""
    if not in_foreground():
        yield KeyPresses(available=False)
        return
    import termios  # noqa: PLC0415 - only on POSIX
    import tty  # noqa: PLC0415

    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)
        yield KeyPresses(available=True)
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
