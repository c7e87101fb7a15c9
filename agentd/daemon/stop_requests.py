"""Requests to end a run that reach a daemon by its launcher or a terminal, and the emergency stop."""

import os
import sys
import threading
from contextlib import suppress

from dcf_zenoh.messaging.events import Agreed, Stop
from dcf_zenoh.messaging.network import Network
from dcf_zenoh.plant import Plant

STOP_WITHIN = 1.0  # s that an emergency stop takes at most
# Lines on standard input.
TAKE_OFF, LAND, STOP = "take off", "land", "stop"


class EmergencyStop:
    """Stops a body past the agent's loop, which may be busy.

    It can be pulled from any thread, even one that must not wait, and before there is a body.

    Attributes:
        landing_time: Landing time of the body, s; 0 before there is one.
    """

    def __init__(self) -> None:
        self.landing_time = 0.0
        self._pulled = threading.Event()
        self._acted = threading.Event()
        self._acted.set()  # there is no body yet

    def pull(self) -> None:
        """Stop the body at once."""
        self._pulled.set()

    def settle(self, seconds: float) -> None:
        """Wait until a body whose emergency stop is pulled has been stopped, at most for `seconds`."""
        if self._pulled.is_set():
            self._acted.wait(seconds)

    def guard(self, plant: Plant) -> None:
        """Stop `plant` as soon as the emergency stop is pulled, for as long as the process lives."""

        def wait() -> None:
            self._pulled.wait()
            try:
                plant.emergency_stop()
            finally:
                self._acted.set()

        self.landing_time = plant.landing_time
        self._acted.clear()
        threading.Thread(target=wait, name="emergency-stop", daemon=True).start()


def read_lines(network: Network, emergency: EmergencyStop, *, supervised: bool) -> None:
    """Turn lines on standard input into events, from now on.

    With a launcher (`supervised`), the end of standard input means that the launcher has ended. Without one, lines are
    read from the terminal, if this process may read from it.
    """

    def read() -> None:
        rest = b""
        with suppress(OSError):  # the terminal is gone, or this process is no longer in its foreground
            while data := os.read(0, 1024):
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    _on_line(line.decode(errors="replace").strip(), network, emergency)
        if supervised:
            network.notify(Stop("stopped by the launcher's end"))

    if supervised or in_foreground():
        threading.Thread(target=read, name="standard-input", daemon=True).start()


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
        emergency.settle(STOP_WITHIN)
        network.notify(Stop("emergency stop by its operator"))
