"""Arbitration between setpoints of a client and the planner on board."""

from plants.crazyflie.emulator.planner import Planner
from plants.crazyflie.emulator.setpoints import STOP, FirmwareSetpoint


class Commander:
    """Present setpoint and its instant.

    A client's setpoint takes over from the planner and stops it; the planner is ignored until the client gives up its
    priority. Then the planner's setpoints are followed again; without a plan it stops the motors.

    Args:
        planner: Planner on board.

    Attributes:
        setpoint: Present setpoint.
        since: Instant of the present setpoint, ms.

    Source: crazyflie-firmware, documentation "The Commander Framework", pull requests 903 and 1298.
    """

    def __init__(self, planner: Planner) -> None:
        self._planner = planner
        self.setpoint = STOP
        self.since = 0
        self._client = False

    def follow(self, setpoint: FirmwareSetpoint, now: int) -> None:
        """Follow a client's setpoint from `now`, ms, on."""
        self.setpoint, self.since, self._client = setpoint, now, True
        self._planner.stop()

    def relax(self) -> None:
        """Give up the client's priority over the planner."""
        self._client = False

    def step(self, now: int) -> None:
        """Advance the planner to `now`, ms; follow its setpoint unless the client has priority."""
        setpoint = self._planner.setpoint(now)
        if not self._client:
            self.setpoint, self.since = setpoint, now
