"""Simulation of a Crazyflie in flight: controller and body, tick by tick. Compiled."""

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
            multiples of `POSITION_EVERY`. Attitude and turn rates are exact.
        wind: Velocity of the air, shape (3,), m/s.
        vehicle: Parameters of the vehicle.
    """
    targets = np.empty(4)
    position, velocity = estimate[:3], estimate[3:]
    for now in range(tick, tick + ticks):
        update(cascade, now, setpoint, position, velocity, roll_pitch_yaw(state), state[10:13])
        for rotor in range(4):
            targets[rotor] = speed_for(cascade.motors[rotor], vehicle)
        state = on_ground(rk4(state, targets, wind, vehicle, TICK))
    return state
