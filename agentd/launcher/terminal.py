"""The operator's terminal during a launch: consent to the take-off, keys to land and to stop."""

from collections.abc import Callable, Mapping

from agentd.daemon.stop_requests import LAND, STOP, TAKE_OFF
from agentd.launcher.daemon_process import DaemonProcess
from agentd.launcher.key_presses import KeyPresses


class Terminal:
    """Passes what the operator decides on to the daemons.

    Args:
        daemons: Agent -> its daemon.
        keys: Key presses on the terminal.
        on_message: Called with a line for the operator.
        real: Whether a body is real, so that the take-off needs consent.
        yes: Whether consent was given on the command line.
    """

    def __init__(
        self,
        daemons: Mapping[int, DaemonProcess],
        keys: KeyPresses,
        on_message: Callable[[str], None],
        *,
        real: bool,
        yes: bool,
    ) -> None:
        self._daemons = daemons
        self._keys = keys
        self._on_message = on_message
        self._consent_needed = real and not yes
        if real and yes:
            self._send_to_all(TAKE_OFF)

    def poll(self) -> None:
        """Ask for consent once all daemons wait for it, and pass on the next key press, if any."""
        if self._consent_needed and all(daemon.status.get("phase") == "agree" for daemon in self._daemons.values()):
            self._consent_needed = False
            for daemon in self._daemons.values():
                checks = ", ".join(f"{name} {value}" for name, value, _ in daemon.status.get("checks", ()))
                self._on_message(f"agent {daemon.agent} is ready: {checks}")
            self._on_message("press t to take off; in flight l to land, x for an emergency stop: motors off")
        key = self._keys.next()
        if request := {"t": TAKE_OFF, "l": LAND, "x": STOP}.get(key):
            self._on_message(f"{key}: {request}")
            self._send_to_all(request)

    def _send_to_all(self, line: str) -> None:
        for daemon in self._daemons.values():
            daemon.send_line(line)
