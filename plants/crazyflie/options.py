"""Keys of the Crazyflie's sub-tables in a fleet file."""

from dataclasses import dataclass
from math import expm1
from typing import Literal, TypeAlias

from plants.crazyflie.flying.bounds import PositionLost, check_range, check_ranges

Reference: TypeAlias = Literal["velocity", "lead", "planned", "integrated", "position"]
DEFAULT = (0.2, 0.3)  # s; sample times at which "velocity" is the default reference, "lead" at others (paper: 0.2)
FOLLOWED = (0.1, 0.3)  # s; sample times at which the reference "velocity" follows accelerations well enough
LOOP = 4.28  # 1/s; acceleration per velocity error of the firmware's velocity loop: 25 deg/(m/s) of tilt, times gravity


@dataclass(frozen=True)
class FlightOptions:
    """Flight of a simulated Crazyflie.

    Attributes:
        height: Height of the flight, in m.
        reference: Reference that the firmware follows under an acceleration a. "velocity": the velocity measured when
            the setpoint acts, + a t_s, as in the paper. "lead": the same with the lead for which the firmware's
            velocity loop gains a t_s within one sample, see `lead_of`. "planned": the setpoint's velocity, which
            problems compute from the state measured at the beginning of the step. "integrated": the last reference
            + a t_s. "position": the setpoint's position, under the firmware's position controller; it is followed
            slowly if it is only a step ahead. None: "velocity" at sample times from 0.2 to 0.3 s, "lead" at others.

    Raises:
        ValueError: `height` is not positive.
    """

    height: float = 1.0
    reference: Reference | None = None

    def __post_init__(self) -> None:
        check_height(self.height)


@dataclass(frozen=True)
class HardwareFlightOptions:
    """Flight of a real Crazyflie.

    Attributes:
        height: Height of the flight, in m.
        reference: Reference that the firmware follows, see `FlightOptions`.
        begin: "go_to": after the take-off the drone flies to `start`; "placed": it refuses to fly if it stands farther
            than 0.15 m from it.
        speed_max: Largest horizontal speed that is commanded, in m/s.
        rate: Rate of the setpoints, in Hz.

    Raises:
        ValueError: A value is out of its range.
    """

    height: float = 0.5
    reference: Reference | None = None
    begin: Literal["go_to", "placed"] = "go_to"
    speed_max: float = 1.0
    rate: float = 50.0

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class WatchdogOptions:
    """Limits that the autopilot of a real Crazyflie watches.

    Attributes:
        battery_min: Least voltage for the take-off, in V.
        battery_low: Voltage in flight below which the drone lands, in V.
        state_age_max: Age of the newest state above which the drone lands, in s.
        hold_after: Time without a command after which the drone holds its position, in s; None: 0.5 s, or 2.5 samples
            if that is longer.
        land_after: Time without a command after which the drone lands, in s; None: 2 s more than `hold_after`.
        unmeasured_after: Time for which the estimator uses no Lighthouse base station, after it had used some, after
            which the position counts as lost, in s.
        variance_max: Variance of the estimated position, on any axis, above which the position counts as lost, in m².
        position_lost: What the drone does when its position is lost. "land": it lands. "continue": it flies on, by its
            gyroscope and accelerometer, and drifts; a warning is logged.

    Raises:
        ValueError: A value is out of its range.
    """

    battery_min: float = 3.7
    battery_low: float = 3.1
    state_age_max: float = 0.5
    hold_after: float | None = None
    land_after: float | None = None
    unmeasured_after: float = 0.5
    variance_max: float = 0.01
    position_lost: PositionLost = "land"

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.battery_low >= self.battery_min:
            raise ValueError(f"battery_low must be below battery_min, {self.battery_min:g} V, not {self.battery_low:g}")


@dataclass(frozen=True)
class ConnectionOptions:
    """Connection to a real Crazyflie.

    Attributes:
        timeout: Time-out of all attempts together, in s.
        retries: Largest number of attempts after the first.
        cache: Folder for the drone's tables; empty: a folder in the user's cache.

    Raises:
        ValueError: A value is out of its range.
    """

    timeout: float = 30.0
    retries: int = 5
    cache: str = ""

    def __post_init__(self) -> None:
        check_range("timeout", self.timeout, 1.0, 300.0, "s")
        check_range("retries", self.retries, 0, 100, "")


@dataclass(frozen=True)
class LocalisationOptions:
    """Measurement of a real Crazyflie's position.

    Attributes:
        geometry: File with the poses of the Lighthouse base stations, which is written to the drone; empty: the drone
            keeps its own.
        pose: Zenoh key on which an external system publishes the drone's pose, see `PoseFeed`; ``{agent}`` stands for
            the id. Empty: the drone measures its position itself.
        pose_endpoint: Zenoh endpoint of that system, such as "tcp/192.168.1.5:7447".
    """

    geometry: str = ""
    pose: str = ""
    pose_endpoint: str = ""


def check_height(height: float) -> None:
    """Check the height of a simulated flight.

    Raises:
        ValueError: The height is not positive.
    """
    if not height > 0:
        raise ValueError(f"height must be positive, in m, not {height}")


def reference_for(reference: Reference | None, sample_time: float) -> Reference:
    """Return the reference that is flown: the given one, or the default at this sample time.

    Raises:
        ValueError: The reference is "velocity", and the sample time is out of its range.
    """
    if reference is None:
        return "velocity" if DEFAULT[0] - 1e-9 <= sample_time <= DEFAULT[1] + 1e-9 else "lead"
    check_reference(reference, sample_time)
    return reference


def lead_of(reference: Reference, sample_time: float) -> float:
    """Return the time, in s, by which an acceleration is multiplied to be added to a velocity.

    The firmware's velocity loop is dv/dt = k (r - v) with k = `LOOP`, once the body has tilted. From v, with r held for
    t_s, it gains (r - v) (1 - exp(-k t_s)); for a gain of a t_s the lead is t_s / (1 - exp(-k t_s)), at short sample
    times 1 / k.
    """
    return sample_time / -expm1(-LOOP * sample_time) if reference == "lead" else sample_time


def check_reference(reference: Reference, sample_time: float) -> None:
    """Check that the reference follows accelerations at this sample time.

    Under the reference "velocity" the body accelerates by about 4.3 t_s a, since the firmware's velocity loop takes 0.3
    s. `position_swap`, with a horizon of 0.6 s, has h = -0.19 at 0.05 s, 0.01 at 0.1 s, 0.06 at 0.15 s, 0.17 at 0.25
    and 0.3 s; at 0.4 s it does not arrive.

    Args:
        reference: Reference that the firmware follows.
        sample_time: Sample time t_s, in s.

    Raises:
        ValueError: The reference is "velocity", and the sample time is out of its range.
    """
    shortest, longest = FOLLOWED
    if reference == "velocity" and not shortest - 1e-9 <= sample_time <= longest + 1e-9:
        raise ValueError(
            f"flight.reference 'velocity' needs a time.sample_time of {shortest:g} to {longest:g} s, not"
            f" {sample_time:g} s: under the measured velocity + a t_s the body accelerates by about"
            f" {4.3 * sample_time:.2g} a, and does not brake as the plans expect; leave the reference out for one that"
            " follows at any sample time ('lead'), or choose a sample time in this range"
        )
