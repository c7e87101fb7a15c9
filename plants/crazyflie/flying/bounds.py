"""Limits for the flight of a real Crazyflie."""

from dataclasses import dataclass, fields
from typing import Any, Literal, TypeAlias

PositionLost: TypeAlias = Literal["land", "continue"]

HEIGHT = (0.1, 2.5)  # m
RANGES = {
    "height": (*HEIGHT, "m"),
    "rate": (10.0, 100.0, "Hz"),
    "speed_max": (0.05, 3.0, "m/s"),
    "state_age_max": (0.1, 1.5, "s"),
    "hold_after": (0.1, 10.0, "s"),
    "land_after": (0.2, 30.0, "s"),
    "unmeasured_after": (0.1, 30.0, "s"),
    "variance_max": (1e-4, 1e3, "m²"),
    "battery_min": (3.0, 4.3, "V"),
    "battery_low": (2.8, 4.0, "V"),
}


@dataclass(frozen=True)
class Bounds:
    """Limits of one flight.

    Attributes:
        rate: Rate of the setpoints, in Hz.
        speed_max: Largest horizontal speed that is commanded, in m/s.
        state_age_max: Age of the newest state above which the drone lands, in s.
        hold_after: Time without a command after which the drone holds its position, in s.
        land_after: Time without a command after which the drone lands, in s.
        battery_min: Least voltage for the take-off, in V.
        battery_low: Voltage in flight below which the drone lands, in V.
        unmeasured_after: Time without an active base station after which the position counts as lost, in s.
        variance_max: Variance of the estimated position, on any axis, above which the position counts as lost, in m².
        position_lost: What the drone does when its position is lost.

    Raises:
        ValueError: A value is out of its range.
    """

    rate: float
    speed_max: float
    state_age_max: float
    hold_after: float
    land_after: float
    battery_min: float
    battery_low: float
    unmeasured_after: float
    variance_max: float
    position_lost: PositionLost

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.land_after <= self.hold_after:
            raise ValueError(f"land_after must be above hold_after, {self.hold_after:g} s, not {self.land_after:g}")


def check_ranges(options: Any) -> None:
    """Check all fields of a dataclass that have a range and a value.

    Raises:
        ValueError: A value is out of its range.
    """
    for field in fields(options):
        value = getattr(options, field.name)
        if field.name in RANGES and value is not None:
            check_range(field.name, value, *RANGES[field.name])


def check_range(name: str, value: float, low: float, high: float, unit: str) -> None:
    """Check that a value is within its range.

    Raises:
        ValueError: The value is out of its range, or NaN.
    """
    if not low <= value <= high:
        raise ValueError(f"{name} must be {low:g} to {high:g}{unit and ' '}{unit}, not {value:g}")


def allowed_height(height: float) -> float:
    """Return the height within the allowed range that is nearest to `height`, in m."""
    return min(max(height, HEIGHT[0]), HEIGHT[1])
