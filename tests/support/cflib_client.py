"""The real cflib, connected to a drone, for tests of what it is connected to."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cflib.crtp
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie

from tests.support.waiting import until


class Client:
    """cflib on one drone.

    Attributes:
        cf: Its `Crazyflie`.
        logged: The newest value of each variable, by name.
        received: How many log packets have come.
        errors: What link errors said.
    """

    def __init__(self, sync: SyncCrazyflie) -> None:
        self.cf = sync.cf
        self.logged: dict[str, float] = {}
        self.received = 0
        self.errors: list[str] = []
        self.cf.supervisor._cache_timeout = 0.0  # what it knows may be from before a restart
        self.cf.connection_lost.add_callback(lambda _, text: self.errors.append(text))

    def renew(self) -> None:
        """Forget what was logged, and log nothing more."""
        self.cf.log.reset()
        self.logged.clear()
        self.received = 0

    def log(self, *names: str, period: int = 20) -> LogConfig:
        """Have variables sent every `period`, ms, and wait for the first."""
        config = LogConfig("block", period)
        for name in names:
            config.add_variable(name)
        config.data_received_cb.add_callback(self._receive)
        self.cf.log.add_config(config)
        config.start()
        until(lambda: names[-1] in self.logged, f"{names[-1]} is logged")
        return config

    def stream(self, seconds: float, send: Callable[[], None], period: float = 0.05) -> None:
        """Send setpoints for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            send()
            time.sleep(period)

    def hover(self, seconds: float, ahead: float = 0.0, left: float = 0.0, height: float = 0.5) -> None:
        """Send hover setpoints for a while; m/s and m."""
        self.stream(seconds, lambda: self.cf.commander.send_hover_setpoint(ahead, left, 0.0, height))

    def arm(self) -> None:
        """Arm, and see that it is."""
        until(lambda: self.cf.supervisor.can_be_armed, "it can be armed")
        self.cf.supervisor.send_arming_request(True)
        until(lambda: self.cf.supervisor.can_fly, "it is armed")

    def take_off(self, height: float = 0.5, duration: float = 1.0) -> None:
        """Arm, and fly up by the planner on board."""
        self.arm()
        self.cf.commander.send_notify_setpoint_stop()
        self.cf.high_level_commander.takeoff(height, duration)
        until(lambda: self.cf.supervisor.hl_control_active, "it takes off")
        until(lambda: self.cf.supervisor.hl_traj_finished, "take-off is over", duration + 5.0)

    def land(self, duration: float = 2.0) -> None:
        """Come down by the planner on board."""
        self.cf.commander.send_notify_setpoint_stop()
        self.cf.high_level_commander.land(0.0, duration)
        until(lambda: not self.cf.supervisor.is_flying, "it has landed", duration + 8.0)

    def stop_pinging(self) -> None:
        """End cflib's pings, for a link that will be lost.

        Where cflib 0.1.34 gets an error while it sends, it waits for its ping thread with the lock held that this
        thread needs to send: both wait for ever.
        """
        self.cf.link_statistics.stop()

    def _receive(self, _time: int, values: dict[str, Any], _block: LogConfig) -> None:
        self.logged.update(values)
        self.received += 1


@contextmanager
def client(uri: str, cache: Path, within: float = 20.0) -> Iterator[Client]:
    """cflib, connected to a drone and with all its parameters."""
    if not cflib.crtp.CLASSES:
        cflib.crtp.init_drivers()
    sync = SyncCrazyflie(uri, cf=Crazyflie(rw_cache=str(cache)))
    opening = threading.Thread(target=_open, args=(sync,), daemon=True)  # it has no time-out of its own
    opening.start()
    opening.join(within)
    assert sync.is_link_open(), f"no connection to {uri} within {within} s"
    try:
        until(sync.is_params_updated, "all parameters have come", within)
        yield Client(sync)
    finally:
        sync.close_link()


def _open(sync: SyncCrazyflie) -> None:
    with contextlib.suppress(Exception):  # it raises no other; whether the link is open is what counts
        sync.open_link()
