"""Who flies the drone: setpoints of a client, or the planner on board."""

from plants.crazyflie.emulator.planner import Planner
from plants.crazyflie.emulator.setpoints import STOP, FirmwareSetpoint


class Commander:
    """Keeps the setpoint that is followed, and when it came.

    A client's setpoint takes over from the planner and stops it, and the planner stays without a say until the client
    gives up its priority. Then the planner's setpoints are followed again; while it has no plan, it stops the motors.

    Args:
        planner: The planner on board.

    Attributes:
        setpoint: What is followed.
        since: When it came, ms.

    Source: crazyflie-firmware, documentation "The Commander Framework", pull requests 903 and 1298.
    """

    def __init__(self, planner: Planner) -> None:
        self._planner = planner
        self.setpoint = STOP
        self.since = 0
        self._client = False

    def follow(self, setpoint: FirmwareSetpoint, now: int) -> None:
        """A client's setpoint, at `now`, ms."""
        self.setpoint, self.since, self._client = setpoint, now, True
        self._planner.stop()

    def relax(self) -> None:
        """The client leaves it to the planner."""
        self._client = False

    def step(self, now: int) -> None:
        """Ask the planner, if it has a say, for a setpoint at `now`, ms."""
        setpoint = self._planner.setpoint(now)
        if not self._client:
            self.setpoint, self.since = setpoint, now
