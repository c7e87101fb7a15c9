"""Within which a real Crazyflie is flown."""

from dataclasses import dataclass, fields

HEIGHT = (0.1, 2.5)  # m
RANGES = {
    "rate": (10.0, 100.0, "Hz"),
    "speed_max": (0.05, 3.0, "m/s"),
    "state_age_max": (0.1, 1.5, "s"),
    "hold_after": (0.1, 10.0, "s"),
    "land_after": (0.2, 30.0, "s"),
    "battery_min": (3.0, 4.3, "V"),
    "battery_low": (2.8, 4.0, "V"),
}


@dataclass(frozen=True)
class Bounds:
    """Numbers that a flight keeps to.

    Attributes:
        rate: Of the setpoints, in Hz.
        speed_max: Longest horizontal velocity that is asked for, in m/s.
        state_age_max: Oldest state to fly by, in s; then it lands.
        hold_after: Time without a command after which it holds, in s.
        land_after: Time without a command after which it lands, in s.
        battery_min: Least voltage for the take-off, in V.
        battery_low: Least voltage in flight, in V; then it lands.

    Raises:
        ValueError: One of them is out of its range.
    """

    rate: float
    speed_max: float
    state_age_max: float
    hold_after: float
    land_after: float
    battery_min: float
    battery_low: float

    def __post_init__(self) -> None:
        for field in fields(self):
            low, high, unit = RANGES[field.name]
            check_range(field.name, getattr(self, field.name), low, high, unit)
        if self.battery_low >= self.battery_min:
            raise ValueError(f"battery_low must be below battery_min, {self.battery_min:g} V, not {self.battery_low:g}")
        if self.land_after <= self.hold_after:
            raise ValueError(f"land_after must be above hold_after, {self.hold_after:g} s, not {self.land_after:g}")


def check_range(name: str, value: float, low: float, high: float, unit: str) -> None:
    """Refuse a value that is out of its range.

    Raises:
        ValueError: It is, or is not a number.
    """
    if not low <= value <= high:
        raise ValueError(f"{name} must be {low:g} to {high:g}{unit and ' '}{unit}, not {value:g}")


def allowed_height(height: float) -> float:
    """The nearest height that may be asked for, in m."""
    return min(max(height, HEIGHT[0]), HEIGHT[1])
