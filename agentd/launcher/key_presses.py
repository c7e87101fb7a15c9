"""Single key presses on the terminal."""

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from agentd.daemon.stop_requests import in_foreground


class KeyPresses:
    """What has been pressed; nothing ever where there is no terminal.

    Attributes:
        there: Whether there is a terminal to press keys on.
    """

    def __init__(self, *, there: bool) -> None:
        self.there = there

    def pressed(self) -> str:
        """The next key, or nothing. Does not wait."""
        if not self.there or not select.select([0], [], [], 0)[0]:
            return ""
        return os.read(0, 1).decode(errors="replace").lower()


@contextmanager
def listen() -> Iterator[KeyPresses]:
    """Take keys as they are pressed, without Enter and without showing them, while the body runs."""
    if not in_foreground():
        yield KeyPresses(there=False)
        return
    import termios  # noqa: PLC0415 - POSIX has it
    import tty  # noqa: PLC0415

    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)
        yield KeyPresses(there=True)
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
