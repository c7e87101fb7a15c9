"""What a person says during a flight, in the terminal of the launcher."""

from collections.abc import Callable, Mapping

from agentd.daemon.stop_requests import LAND, STOP, TAKE_OFF
from agentd.launcher.daemon_process import DaemonProcess
from agentd.launcher.key_presses import KeyPresses


class Terminal:
    """Looks after what a person has to say during a flight: when it begins, and when it shall end.

    Args:
        daemons: The fleet.
        keys: Of the terminal.
        say: Told what can be said.
        real: Somebody has to agree to the take-off.
        yes: Somebody has.
    """

    def __init__(
        self,
        daemons: Mapping[int, DaemonProcess],
        keys: KeyPresses,
        say: Callable[[str], None],
        *,
        real: bool,
        yes: bool,
    ) -> None:
        self._daemons = daemons
        self._keys = keys
        self._say = say
        self._asks = real and not yes
        if real and yes:
            self._tell(TAKE_OFF)

    def look(self) -> None:
        """Ask for the take-off once everybody waits for it, and pass on what was said."""
        if self._asks and all(daemon.status.get("phase") == "agree" for daemon in self._daemons.values()):
            self._asks = False
            for daemon in self._daemons.values():
                found = ", ".join(f"{name} {value}" for name, value, _ in daemon.status.get("checks", ()))
                self._say(f"agent {daemon.agent} is ready: {found}")
            self._say("press t to take off; in flight l to land, x for an emergency stop: motors off")
        key = self._keys.pressed()
        if word := {"t": TAKE_OFF, "l": LAND, "x": STOP}.get(key):
            self._say(f"{key}: {word}")
            self._tell(word)

    def _tell(self, word: str) -> None:
        for daemon in self._daemons.values():
            daemon.tell(word)
