"""Cascaded controller of the Crazyflie: four nested loops and the mixer. Compiled.

Position -> velocity -> attitude -> turn rate -> motor commands, with the rates, limits and resets of the firmware's
default (`controller_pid`, CF2 gains). Written from the firmware's behaviour and parameters, in the units of its gains:
angles in degrees, outputs in motor commands 0 .. 65535. Two signs differ from the firmware: pitch is positive nose down
(right-handed about y), and so is its term in the mixer.

Not modelled: the filters of gyroscope and accelerometer, and the firmware's single precision.

Sources: Bitcraze, crazyflie-firmware, `platform_defaults_cf2.h` (gains and limits), documentation "Cascaded PID
controller" and pull request 1645 (resets, 2026).
"""

import math
from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array
from plants.crazyflie.model.compiled import compiled

POSITION_EVERY = 10  # ticks of 1 ms: position and velocity loops at 100 Hz
ATTITUDE_EVERY = 2  # attitude and rate loops at 500 Hz
TICK = 0.001  # s; the mixer runs at every tick

# Modes of setpoints, with the meaning of the three values and of the fourth, heading or yaw rate.
STOPPED = 0  # motors off
VELOCITY = 1  # [vx, vy, vz] in the world, m/s; yaw rate, rad/s
HOVER = 2  # [vx, vy] along the heading, m/s, and height, m; yaw rate, rad/s
POSITION = 3  # [x, y, z], m; yaw, rad
TILT_HEIGHT = 4  # [roll, pitch], rad, and height, m; yaw rate, rad/s
TILT_CLIMB = 5  # [roll, pitch], rad, and vertical velocity, m/s; yaw rate, rad/s
TILT_THRUST = 6  # [roll, pitch], rad, and common motor command; yaw rate, rad/s

X, Y, Z, VX, VY, VZ, ROLL, PITCH, YAW, ROLL_RATE, PITCH_RATE, YAW_RATE = range(12)
# One row per loop: kp, ki, kd, limit of the integral, limit of the output (0: no limit).
GAINS = np.array(
    [
        [2.0, 0.0, 0.0, 5000.0, 1.1],  # m -> m/s
        [2.0, 0.0, 0.0, 5000.0, 1.1],
        [2.0, 0.5, 0.0, 5000.0, 1.1],
        [25.0, 1.0, 0.0, 5000.0, 22.0],  # m/s -> deg
        [25.0, 1.0, 0.0, 5000.0, 22.0],
        [25.0, 15.0, 0.0, 5000.0, 32.767],  # m/s -> 1000 motor commands
        [6.0, 3.0, 0.0, 20.0, 0.0],  # deg -> deg/s
        [6.0, 3.0, 0.0, 20.0, 0.0],
        [6.0, 1.0, 0.35, 360.0, 0.0],
        [250.0, 500.0, 2.5, 33.3, 0.0],  # deg/s -> motor command
        [250.0, 500.0, 2.5, 33.3, 0.0],
        [120.0, 16.7, 0.0, 166.7, 0.0],
    ]
)
TILT_MAX = 20.0  # deg
THRUST_BASE, THRUST_SCALE, THRUST_MIN, COMMAND_MAX = 36000.0, 1000.0, 20000.0, 65535.0
SHORT_MAX = 32767.0  # outputs of the rate loops are 16-bit numbers


class CascadeSetpoint(NamedTuple):
    """Setpoint of the cascade.

    Attributes:
        mode: Mode, from STOPPED to TILT_THRUST.
        values: Three values and a heading or yaw rate, see the modes, shape (4,).
    """

    mode: int
    values: Array


class Cascade(NamedTuple):
    """State of the cascade; `update` changes it in place.

    Attributes:
        integral: Integral of each loop's error, in loop order X .. YAW_RATE, shape (12,).
        measured: Last measurement of each loop, for the derivative, shape (12,).
        attitude: Reference of roll, pitch, yaw, deg, shape (3,).
        thrust: Common motor command, shape (1,).
        output: Outputs of the rate loops for roll, pitch, yaw, in motor commands, shape (3,).
        mode: Mode of the last setpoint, shape (1,).
        motors: Commands to the four motors, 0 .. 65535, shape (4,).
    """

    integral: Array
    measured: Array
    attitude: Array
    thrust: Array
    output: Array
    mode: Array
    motors: Array

    @classmethod
    def fresh(cls) -> "Cascade":
        """Return the state after power-on: motors off, no setpoint yet."""
        return cls(*(np.zeros(size) for size in (12, 12, 3, 1, 3, 1, 4)))

    @classmethod
    def hovering(cls, command: float, yaw: float) -> "Cascade":
        """Return the state of steady hover at a motor `command` and heading `yaw`, in rad.

        The vertical integrator carries the weight.
        """
        cascade = cls.fresh()
        cascade.attitude[2] = cascade.measured[YAW] = math.degrees(yaw)
        cascade.integral[VZ] = (command - THRUST_BASE) / THRUST_SCALE / GAINS[VZ, 1]
        cascade.thrust[0] = command
        cascade.mode[0] = HOVER
        cascade.motors[:] = int(command)
        return cascade


@compiled
def update(
    cascade: Cascade,
    tick: int,
    command: CascadeSetpoint,
    position: Array,
    velocity: Array,
    angles: tuple[float, float, float],
    rates: Array,
) -> None:
    """Run the cascade for one tick of 1 ms; the motor commands are in `cascade.motors` afterwards.

    Args:
        cascade: State of the cascade; it changes.
        tick: Number of the tick; it determines which loops run.
        command: Setpoint to follow.
        position: Estimated position, m, world, shape (3,).
        velocity: Estimated velocity, m/s, world, shape (3,).
        angles: Estimated roll, pitch (positive nose down), yaw, rad.
        rates: Measured turn rates, rad/s, body, shape (3,).
    """
    mode, setpoint = command.mode, command.values
    roll, pitch, yaw = math.degrees(angles[0]), math.degrees(angles[1]), math.degrees(angles[2])
    if mode != cascade.mode[0]:
        reset(cascade, position, roll, pitch, yaw)
        cascade.mode[0] = mode
    if tick % ATTITUDE_EVERY == 0:
        heading = math.degrees(setpoint[3])
        cascade.attitude[2] = wrapped(
            heading if mode == POSITION else cascade.attitude[2] + heading * ATTITUDE_EVERY * TICK
        )
    if tick % POSITION_EVERY == 0:
        wanted = velocity_wanted(cascade, mode, setpoint, position, angles[2])
        attitude_and_thrust(cascade, wanted, velocity, angles[2])
        if mode >= TILT_HEIGHT:
            cascade.attitude[0], cascade.attitude[1] = math.degrees(setpoint[0]), math.degrees(setpoint[1])
        if mode == TILT_THRUST:
            cascade.thrust[0] = setpoint[2]
    if mode == STOPPED:
        cascade.thrust[0] = 0.0
    if tick % ATTITUDE_EVERY == 0:
        turn(cascade, roll, pitch, yaw, rates)
    if cascade.thrust[0] == 0.0:
        cascade.output[0] = cascade.output[1] = cascade.output[2] = 0.0
        reset(cascade, position, roll, pitch, yaw)
        cascade.attitude[2] = yaw
    mix(cascade)


@compiled
def pid(cascade: Cascade, loop: int, error: float, measured: float, change: float, period: float) -> float:
    """Return the output of one loop: PID with the derivative of the measurement, `change` per `period` (s)."""
    kp, ki, kd, integral_max, output_max = GAINS[loop]
    integral = cascade.integral[loop] + error * period
    integral = min(integral_max, max(-integral_max, integral))
    cascade.integral[loop] = integral
    cascade.measured[loop] = measured
    output: float = kp * error + ki * integral - kd * change / period
    if output_max > 0.0:
        output = min(output_max, max(-output_max, output))
    return output


@compiled
def plain(cascade: Cascade, loop: int, wanted: float, measured: float, period: float) -> float:
    """Return the output of a loop whose values do not wrap around."""
    return pid(cascade, loop, wanted - measured, measured, measured - cascade.measured[loop], period)


@compiled
def wrapped(angle: float) -> float:
    """Return the equivalent angle in -180 .. 180 deg."""
    return angle - 360.0 * math.floor((angle + 180.0) / 360.0)


@compiled
def velocity_wanted(
    cascade: Cascade, mode: int, setpoint: Array, position: Array, yaw: float
) -> tuple[float, float, float]:
    """Run the position loops; return the wanted velocity along the heading, to the left of it and up, m/s."""
    period = POSITION_EVERY * TICK
    cosine, sine = math.cos(yaw), math.sin(yaw)
    ahead, left, up = setpoint[0], setpoint[1], setpoint[2]
    if mode != HOVER:  # given in the world frame
        ahead, left = cosine * ahead + sine * left, cosine * left - sine * ahead
    if mode == POSITION:
        here_ahead = cosine * position[0] + sine * position[1]
        here_left = cosine * position[1] - sine * position[0]
        ahead = plain(cascade, X, ahead, here_ahead, period)
        left = plain(cascade, Y, left, here_left, period)
    if mode in (HOVER, POSITION, TILT_HEIGHT):
        up = plain(cascade, Z, up, position[2], period)
    return ahead, left, up


@compiled
def attitude_and_thrust(cascade: Cascade, wanted: tuple[float, float, float], velocity: Array, yaw: float) -> None:
    """Run the velocity loops: they set the wanted roll and pitch, and the common motor command."""
    period = POSITION_EVERY * TICK
    cosine, sine = math.cos(yaw), math.sin(yaw)
    ahead, left = cosine * velocity[0] + sine * velocity[1], cosine * velocity[1] - sine * velocity[0]
    pitch = plain(cascade, VX, wanted[0], ahead, period)
    roll = -plain(cascade, VY, wanted[1], left, period)
    cascade.attitude[0] = min(TILT_MAX, max(-TILT_MAX, roll))
    cascade.attitude[1] = min(TILT_MAX, max(-TILT_MAX, pitch))
    thrust = THRUST_SCALE * plain(cascade, VZ, wanted[2], velocity[2], period) + THRUST_BASE
    cascade.thrust[0] = min(COMMAND_MAX, max(THRUST_MIN, thrust))


@compiled
def turn(cascade: Cascade, roll: float, pitch: float, yaw: float, rates: Array) -> None:
    """Run the attitude loops and the rate loops inside them; angles in deg, rates in rad/s."""
    period = ATTITUDE_EVERY * TICK
    yaw_error = wrapped(cascade.attitude[2] - yaw)
    yaw_change = wrapped(yaw - cascade.measured[YAW])
    wanted = (
        plain(cascade, ROLL, cascade.attitude[0], roll, period),
        plain(cascade, PITCH, cascade.attitude[1], pitch, period),
        pid(cascade, YAW, yaw_error, yaw, yaw_change, period),
    )
    for axis in range(3):
        output = plain(cascade, ROLL_RATE + axis, wanted[axis], math.degrees(rates[axis]), period)
        cascade.output[axis] = int(min(SHORT_MAX, max(-SHORT_MAX, output)))


@compiled
def mix(cascade: Cascade) -> None:
    """Compute the motor commands; if one exceeds the maximum, all are lowered by the same amount."""
    thrust = cascade.thrust[0]
    roll, pitch, yaw = int(cascade.output[0] / 2), int(cascade.output[1] / 2), cascade.output[2]
    motors = cascade.motors
    motors[0] = int(thrust - roll - pitch - yaw)
    motors[1] = int(thrust - roll + pitch + yaw)
    motors[2] = int(thrust + roll + pitch - yaw)
    motors[3] = int(thrust + roll - pitch + yaw)
    excess = max(0.0, max(motors[0], motors[1], motors[2], motors[3]) - COMMAND_MAX)
    for motor in range(4):
        motors[motor] = max(0.0, motors[motor] - excess)


@compiled
def reset(cascade: Cascade, position: Array, roll: float, pitch: float, yaw: float) -> None:
    """Reset all integrals, as the firmware does when the mode of the setpoint changes and while there is no thrust."""
    for loop in range(len(GAINS)):
        cascade.integral[loop] = 0.0
        cascade.measured[loop] = position[loop] if loop <= Z else 0.0
    cascade.measured[ROLL], cascade.measured[PITCH], cascade.measured[YAW] = roll, pitch, yaw
    cascade.attitude[0], cascade.attitude[1] = roll, pitch
