"""Simulation of a Crazyflie in flight: controller and body, tick by tick. Compiled."""

import math

import numpy as np

from dcf_zenoh.plant import Array
from plants.crazyflie.model.cascade import TICK, Cascade, CascadeSetpoint, update
from plants.crazyflie.model.compiled import compiled
from plants.crazyflie.model.dynamics import on_ground, rk4, roll_pitch_yaw, speed_for
from plants.crazyflie.model.vehicle import Vehicle


@compiled
def fly(
    state: Array,
    cascade: Cascade,
    tick: int,
    ticks: int,
    setpoint: CascadeSetpoint,
    estimate: Array,
    tilt_error: Array,
    wind: Array,
    vehicle: Vehicle,
) -> Array:
    """Return the state of the body `ticks` ms later, with the controller in the loop.

    Args:
        state: State of the body, shape (17,), see `dynamics`.
        cascade: State of the controller; it changes.
        tick: Number of the first tick.
        ticks: Number of ticks.
        setpoint: Setpoint to follow.
        estimate: Estimated position and velocity for the controller, shape (6,), m and m/s; used in ticks that are
            multiples of `POSITION_EVERY`. Turn rates are exact.
        tilt_error: Estimated minus true tilt along the world's x and y, shape (2,), rad; see `attitude_estimate`.
        wind: Velocity of the air, shape (3,), m/s.
        vehicle: Parameters of the vehicle.
    """
    targets = np.empty(4)
    position, velocity = estimate[:3], estimate[3:]
    for now in range(tick, tick + ticks):
        roll, pitch, yaw = roll_pitch_yaw(state)
        if tilt_error[0] != 0.0 or tilt_error[1] != 0.0:
            cosine, sine = math.cos(yaw), math.sin(yaw)
            roll -= cosine * tilt_error[1] - sine * tilt_error[0]
            pitch += cosine * tilt_error[0] + sine * tilt_error[1]
        update(cascade, now, setpoint, position, velocity, (roll, pitch, yaw), state[10:13])
        for rotor in range(4):
            targets[rotor] = speed_for(cascade.motors[rotor], vehicle)
        state = on_ground(rk4(state, targets, wind, vehicle, TICK))
    return state
