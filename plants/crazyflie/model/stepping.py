"""Simulation of a Crazyflie in flight: controller and body, tick by tick. Compiled."""

import numpy as np

from dcf_zenoh.plant import Array
from plants.crazyflie.model.cascade import TICK, Cascade, update
from plants.crazyflie.model.compiled import compiled
from plants.crazyflie.model.dynamics import on_ground, rk4, roll_pitch_yaw, speed_for
from plants.crazyflie.model.vehicle import Vehicle


@compiled
def fly(
    state: Array,
    cascade: Cascade,
    tick: int,
    ticks: int,
    mode: int,
    setpoint: Array,
    estimate: Array,
    wind: Array,
    vehicle: Vehicle,
) -> Array:
    """The body's state `ticks` ms later, the controller in the loop.

    Args:
        state: Of the body, shape (17,), see `dynamics`.
        cascade: The controller's memory; it changes.
        tick: Number of the first tick.
        ticks: How many.
        mode: Of the setpoint, see `cascade`.
        setpoint: Shape (4,).
        estimate: Position and velocity that the controller believes in, shape (6,), m and m/s. It looks at them in
            ticks that are multiples of `POSITION_EVERY`. Attitude and turn rates it knows exactly.
        wind: Velocity of the air, shape (3,), m/s.
        vehicle: Its parameters.
    """
    targets = np.empty(4)
    position, velocity = estimate[:3], estimate[3:]
    for now in range(tick, tick + ticks):
        update(cascade, now, mode, setpoint, position, velocity, roll_pitch_yaw(state), state[10:13])
        for rotor in range(4):
            targets[rotor] = speed_for(cascade.motors[rotor], vehicle)
        state = on_ground(rk4(state, targets, wind, vehicle, TICK))
    return state
