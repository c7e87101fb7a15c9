"""Battery model: the voltage falls with charge and load."""

BATTERY, LOW_POWER = 0, 3  # states as the firmware reports them
# Our assumption: full at 4.1 V, empty after about 7 minutes of hovering, and lower by 0.3 V in hover.
FULL, EMPTY = 4.1, 3.0  # V
HOVERING, ENDURANCE, SAG = 0.6, 420.0, 0.3  # mean motor command over its maximum; s; V
LOW, LOW_FOR = 3.2, 5.0  # V, and s after which the state is LOW_POWER
LEVELS = (3.00, 3.78, 3.83, 3.87, 3.89, 3.92, 3.96, 4.00, 4.04, 4.10)  # V at 0, 10 .. 90 %: crazyflie-firmware, pm


class Battery:
    """Battery of one cell.

    Attributes:
        rest: Voltage without load, V.
        voltage: Present voltage, V.
    """

    def __init__(self) -> None:
        self.rest = FULL
        self.voltage = FULL
        self._low_for = 0.0

    @property
    def level(self) -> int:
        """Charge in per cent, in steps of 10, computed as in the firmware."""
        return 10 * min(9, sum(self.voltage > level for level in LEVELS))

    @property
    def state(self) -> int:
        """State as the firmware reports it: BATTERY or LOW_POWER."""
        return LOW_POWER if self._low_for > LOW_FOR else BATTERY

    def set(self, voltage: float) -> None:
        """Set the voltage, V, under the present load."""
        self.rest += voltage - self.voltage
        self.voltage = voltage

    def step(self, load: float, duration: float) -> None:
        """Advance by `duration`, s, under a `load`, the mean motor command over its maximum."""
        self.rest -= (FULL - EMPTY - SAG) / ENDURANCE * load / HOVERING * duration
        self.voltage = self.rest - SAG * load / HOVERING
        self._low_for = self._low_for + duration if self.voltage < LOW else 0.0
