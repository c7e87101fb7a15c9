"""Requests to end a run that reach a daemon by its launcher, a terminal or a signal, and the emergency stop."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from dcf_zenoh.messaging.network import Agreed, Network, Stop
from dcf_zenoh.plant import Plant

# Lines on standard input.
TAKE_OFF, LAND, STOP = "take off", "land", "stop"


class EmergencyStop:
    """Stops a body past the agent's loop, which may be busy.

    It can be pulled from any thread, even one that must not wait, and before there is a body.
    """

    def __init__(self) -> None:
        self._pulled = threading.Event()

    def pull(self) -> None:
        """Stop the body at once."""
        self._pulled.set()

    def guard(self, plant: Plant) -> None:
        """Stop `plant` as soon as the emergency stop is pulled, for as long as the process lives."""

        def wait() -> None:
            self._pulled.wait()
            plant.emergency_stop()

        threading.Thread(target=wait, name="emergency-stop", daemon=True).start()


@contextmanager
def listening(network: Network, emergency: EmergencyStop, *, supervised: bool) -> Iterator[None]:
    """Turn signals and lines on standard input into events while the body runs.

    With a launcher (`supervised`), the end of standard input means that the launcher has ended. Without one, lines are
    read from the terminal, if this process may read from it.
    """

    def on_signal(number: int, _frame: FrameType | None) -> None:
        network.notify(Stop(f"stopped by {signal.Signals(number).name}"))

    def read() -> None:
        rest = b""
        while data := os.read(0, 1024):
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                _on_line(line.decode(errors="replace").strip(), network, emergency)
        if supervised:
            network.notify(Stop("stopped by the launcher's end"))

    before = {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    if supervised or in_foreground():
        threading.Thread(target=read, name="standard-input", daemon=True).start()
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def in_foreground() -> bool:
    """Return whether standard input is a terminal that this process may read from."""
    try:
        return sys.stdin.isatty() and os.tcgetpgrp(0) == os.getpgrp()
    except (OSError, ValueError, AttributeError):  # closed, or a system without process groups
        return False


def _on_line(line: str, network: Network, emergency: EmergencyStop) -> None:
    if line == TAKE_OFF:
        network.notify(Agreed())
    elif line == LAND:
        network.notify(Stop("landed by its operator"))
    elif line == STOP:
        emergency.pull()
        network.notify(Stop("emergency stop by its operator"))
