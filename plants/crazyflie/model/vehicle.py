"""Parameters of a Crazyflie, read from TOML files."""

import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dcf_zenoh.plant import Array

FOLDER = Path(__file__).parents[1] / "parameters"
RPM = np.pi / 30  # rad/s
COMMAND_MAX = 65535.0


class Vehicle(NamedTuple):
    """Physical parameters of one vehicle. Polynomials begin with the constant term.

    Attributes:
        mass: Total mass, kg.
        gravity: Acceleration of gravity, m/s².
        inertia: Moment of inertia, shape (3, 3), kg m², body frame.
        inertia_inverse: Inverse of `inertia`, shape (3, 3), 1 / (kg m²).
        lever: Distance of a rotor's axis from the body's x and y axes, m.
        rotor_inertia: Moment of inertia of one rotor with its motor, kg m².
        thrust: Thrust of a rotor, N, as a quadratic polynomial of its speed in rad/s.
        torque: Drag torque of a rotor, N m, as a quadratic polynomial of its speed in rad/s.
        command: Steady thrust of a rotor, N, as a quadratic polynomial of the motor command, 0 .. 65535.
        faster: Coefficients a, b of d(speed)/dt = a (target - speed) + b (target² - speed²), 1/s and 1/rad, when the
            speed is below its target.
        slower: The same coefficients when the speed is above its target.
        thrust_lag: Time constant of the thrust, s; 0 if `faster` and `slower` describe the lag completely.
        drag: Drag coefficients on the body's axes, relative to the air, kg/s.
        drag_per_speed: Increase of `drag` per rad/s of the sum of rotor speeds, kg/rad.
    """

    mass: float
    gravity: float
    inertia: Array
    inertia_inverse: Array
    lever: float
    rotor_inertia: float
    thrust: tuple[float, float, float]
    torque: tuple[float, float, float]
    command: tuple[float, float, float]
    faster: tuple[float, float]
    slower: tuple[float, float]
    thrust_lag: float
    drag: tuple[float, float, float]
    drag_per_speed: tuple[float, float, float]

    @property
    def thrust_max(self) -> float:
        """Maximum thrust of all rotors together, N."""
        return 4 * float(np.polyval(self.command[::-1], COMMAND_MAX))

    @property
    def weight(self) -> float:
        """Weight of the vehicle, N."""
        return self.mass * self.gravity

    @property
    def hover_speed(self) -> float:
        """Rotor speed in hover, rad/s."""
        return float(np.roots([*self.thrust[:0:-1], self.thrust[0] - self.weight / 4]).max())

    @property
    def hover_command(self) -> float:
        """Motor command in hover, 0 .. 65535."""
        c, b, a = self.command[0] - self.weight / 4, self.command[1], self.command[2]
        return float(-c / b if a == 0 else (-b + np.sqrt(b * b - 4 * a * c)) / (2 * a))

    def carrying(self, mass: float) -> "Vehicle":
        """Return the vehicle with another total `mass`, kg; the inertia stays, as for a load in the centre.

        Raises:
            ValueError: The mass is not positive, or the maximum thrust is less than 1.1 times the weight.
        """
        liftable = self.thrust_max / self.gravity / 1.1
        if not 0 < mass <= liftable:
            raise ValueError(
                f"mass must be positive and at most {liftable:.3g}, in kg, the most that the rotors carry, not {mass}"
            )
        return self._replace(mass=mass)


def known() -> list[str]:
    """Return the names of the available parameter sets."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def read(name: str) -> Vehicle:
    """Read the vehicle of a parameter set.

    Raises:
        ValueError: There is no such set; the message names the available ones.
    """
    if name not in known():
        raise ValueError(f"unknown parameters {name!r}; known: {', '.join(known())}")
    return vehicle_of(tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8")))


def vehicle_of(table: dict[str, Any]) -> Vehicle:
    """Return the vehicle of a parameter file, whose numbers are in the units of their source."""
    thrust, torque, command = _rotor_curves(table["rotor"])
    lag = table["rotor"]["lag"]
    inertia = np.array(table["inertia"])
    inverse = np.linalg.inv(inertia)
    for array in (inertia, inverse):
        array.setflags(write=False)
    return Vehicle(
        mass=table["mass"],
        gravity=table["gravity"],
        inertia=inertia,
        inertia_inverse=inverse,
        lever=table["lever"],
        rotor_inertia=table["rotor"]["inertia"],
        thrust=_three(thrust),
        torque=_three(torque),
        command=_three(command),
        faster=_per_rpm(lag.get("faster_rpm", [0.0, 0.0])),
        slower=_per_rpm(lag.get("slower_rpm", [0.0, 0.0])),
        thrust_lag=float(lag.get("thrust", 0.0)),
        drag=_three(table["drag"].get("constant", [0.0] * 3)),
        drag_per_speed=_three(table["drag"].get("per_rotor_speed", [0.0] * 3)),
    )


def _rotor_curves(rotor: dict[str, Any]) -> tuple[Array, Array, Array]:
    """Return thrust and torque over speed, and thrust over command, from the curves that the source gives."""
    command = np.array(rotor["thrust_of_command"])
    if "thrust_of_rpm" in rotor:
        powers = RPM ** -np.arange(3.0)
        return np.array(rotor["thrust_of_rpm"]) * powers, np.array(rotor["torque_of_rpm"]) * powers, command
    offset, slope = rotor["speed_of_command"]
    c0, c1, c2 = command
    shift = -offset / slope  # command = shift + speed / slope
    thrust = np.array([c0 + c1 * shift + c2 * shift**2, (c1 + 2 * c2 * shift) / slope, c2 / slope**2])
    constant, per_thrust = rotor["torque_of_thrust"]
    return thrust, per_thrust * thrust + np.array([constant, 0.0, 0.0]), command


def _three(values: Any) -> tuple[float, float, float]:
    a, b, c = (float(value) for value in values)
    return a, b, c


def _per_rpm(values: Any) -> tuple[float, float]:
    """Convert coefficients of speed and squared speed from rpm."""
    return float(values[0]), float(values[1]) / RPM
