"""Dynamics of a quadrotor: rigid body, four rotors, drag, ground. Pure functions, compiled.

World frame: z up. Body frame: x forward, y left, z up. State, shape (17,), SI units:

    0:3    position, m, world
    3:7    attitude, unit quaternion [x, y, z, w] that turns body vectors into world vectors
    7:10   velocity, m/s, world
    10:13  turn rates, rad/s, body
    13:17  rotor speeds, rad/s, positive

Rotors: 1 front right, 2 back right, 3 back left, 4 front left, at ±lever on both axes; 1 and 3 turn counter-clockwise
seen from above. The parameters are the fields of a `Vehicle`, since numba has no keyword-only arguments.

Sources: rigid body and reaction of the rotors: Mahony, Kumar, Corke, "Multirotor Aerial Vehicles", IEEE RAM 2012,
with the angular momentum of the rotors kept; drag and rotor curves: J. Förster, "System Identification
of the Crazyflie 2.0 Nano Quadrocopter", ETH Zurich 2015.
"""

import math

import numpy as np

from dcf_zenoh.plant import Array
from plants.crazyflie.model.compiled import compiled
from plants.crazyflie.model.vehicle import Vehicle

STATES = 17


@compiled
def thrust(speed: float, vehicle: Vehicle) -> float:
    """Return the thrust of one rotor, N, at a `speed`, rad/s."""
    return vehicle.thrust[0] + (vehicle.thrust[1] + vehicle.thrust[2] * speed) * speed


@compiled
def speed_for(command: float, vehicle: Vehicle) -> float:
    """Return the steady speed of a rotor, rad/s, under a constant motor `command`, 0 .. 65535."""
    steady = vehicle.command[0] + (vehicle.command[1] + vehicle.command[2] * command) * command  # N
    c, b, a = vehicle.thrust[0] - steady, vehicle.thrust[1], vehicle.thrust[2]  # thrust(speed) = steady
    return (-b + math.sqrt(max(0.0, b * b - 4 * a * c))) / (2 * a)


@compiled
def spin_up(speed: float, target: float, vehicle: Vehicle) -> float:
    """Return the acceleration of a rotor, rad/s², at `speed` with the steady speed `target`, rad/s."""
    gap, square_gap = target - speed, target * target - speed * speed
    if gap > 0:
        change = vehicle.faster[0] * gap + vehicle.faster[1] * square_gap
    else:
        change = vehicle.slower[0] * gap + vehicle.slower[1] * square_gap
    if vehicle.thrust_lag > 0:  # first-order lag of the thrust: dT/dspeed · change = dT/dt = (T(target) - T) / lag
        slope = vehicle.thrust[1] + 2 * vehicle.thrust[2] * speed
        change += (vehicle.thrust[1] * gap + vehicle.thrust[2] * square_gap) / (slope * vehicle.thrust_lag)
    return change


@compiled
def turn(rate: Array, state: Array, torque: tuple[float, float, float], momentum: float, vehicle: Vehicle) -> None:
    """Set the acceleration of the turn rates in `rate` by Euler's equation, J dω/dt = τ - ω x (J ω + h).

    Args:
        rate: Rate of change of `state`, shape (17,).
        state: State of the body, shape (17,).
        torque: τ, N m, body frame.
        momentum: Angular momentum of the rotors h, along body z, N m s.
        vehicle: Parameters of the vehicle.
    """
    p, q, r = state[10], state[11], state[12]
    torque_x, torque_y, torque_z = torque
    inertia, inverse = vehicle.inertia, vehicle.inertia_inverse
    spin_x = inertia[0, 0] * p + inertia[0, 1] * q + inertia[0, 2] * r
    spin_y = inertia[1, 0] * p + inertia[1, 1] * q + inertia[1, 2] * r
    spin_z = inertia[2, 0] * p + inertia[2, 1] * q + inertia[2, 2] * r + momentum
    torque_x -= q * spin_z - r * spin_y
    torque_y -= r * spin_x - p * spin_z
    torque_z -= p * spin_y - q * spin_x
    for axis in range(3):
        rate[10 + axis] = inverse[axis, 0] * torque_x + inverse[axis, 1] * torque_y + inverse[axis, 2] * torque_z


@compiled
def derivative(state: Array, targets: Array, wind: Array, vehicle: Vehicle) -> Array:
    """Return the rate of change of `state`, shape (17,), in the unit of each component per s.

    Args:
        state: State of the body, shape (17,).
        targets: Steady speeds of the rotors under the present motor commands, shape (4,), rad/s.
        wind: Velocity of the air, shape (3,), m/s, world.
        vehicle: Parameters of the vehicle.
    """
    rate = np.empty(STATES)
    x, y, z, w = state[3], state[4], state[5], state[6]
    p, q, r = state[10], state[11], state[12]

    # Forces in the body frame; columns of the rotation matrix are the body axes in the world.
    xx, xy, xz = 1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)
    yx, yy, yz = 2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)
    zx, zy, zz = 2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)
    air_x, air_y, air_z = state[7] - wind[0], state[8] - wind[1], state[9] - wind[2]
    total_speed = state[13] + state[14] + state[15] + state[16]
    drag = vehicle.drag
    spun = vehicle.drag_per_speed
    t1, t2, t3, t4 = (
        thrust(state[13], vehicle), thrust(state[14], vehicle), thrust(state[15], vehicle), thrust(state[16], vehicle),
    )  # fmt: skip
    force_x = -(drag[0] + spun[0] * total_speed) * (xx * air_x + xy * air_y + xz * air_z)
    force_y = -(drag[1] + spun[1] * total_speed) * (yx * air_x + yy * air_y + yz * air_z)
    force_z = -(drag[2] + spun[2] * total_speed) * (zx * air_x + zy * air_y + zz * air_z) + t1 + t2 + t3 + t4
    mass = vehicle.mass
    rate[0], rate[1], rate[2] = state[7], state[8], state[9]
    rate[7] = (xx * force_x + yx * force_y + zx * force_z) / mass
    rate[8] = (xy * force_x + yy * force_y + zy * force_z) / mass
    rate[9] = (xz * force_x + yz * force_y + zz * force_z) / mass - vehicle.gravity

    # Attitude: half the quaternion product with the turn rates.
    rate[3] = 0.5 * (w * p + y * r - z * q)
    rate[4] = 0.5 * (w * q + z * p - x * r)
    rate[5] = 0.5 * (w * r + x * q - y * p)
    rate[6] = -0.5 * (x * p + y * q + z * r)

    # Rotors, and their moments: a rotor that turns counter-clockwise drags the body clockwise.
    momentum = 0.0
    torque_z = 0.0
    for rotor in range(4):
        counter_clockwise = 1.0 if rotor % 2 == 0 else -1.0
        speed = state[13 + rotor]
        change = spin_up(speed, targets[rotor], vehicle)
        rate[13 + rotor] = change
        curve = vehicle.torque
        dragged = curve[0] + (curve[1] + curve[2] * speed) * speed + vehicle.rotor_inertia * change
        torque_z -= counter_clockwise * dragged
        momentum += counter_clockwise * vehicle.rotor_inertia * speed
    torque_x = vehicle.lever * (t3 + t4 - t1 - t2)
    torque_y = vehicle.lever * (t2 + t3 - t1 - t4)

    turn(rate, state, (torque_x, torque_y, torque_z), momentum, vehicle)
    return rate


@compiled
def rk4(state: Array, targets: Array, wind: Array, vehicle: Vehicle, step: float) -> Array:
    """Return the state after a `step`, in s, by the classical Runge-Kutta method; the quaternion is normalised."""
    k1 = derivative(state, targets, wind, vehicle)
    k2 = derivative(moved(state, k1, step / 2), targets, wind, vehicle)
    k3 = derivative(moved(state, k2, step / 2), targets, wind, vehicle)
    k4 = derivative(moved(state, k3, step), targets, wind, vehicle)
    later = np.empty(STATES)
    for i in range(STATES):
        later[i] = state[i] + (step / 6) * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i])
    length = math.sqrt(later[3] ** 2 + later[4] ** 2 + later[5] ** 2 + later[6] ** 2)
    for i in range(3, 7):
        later[i] /= length
    return later


@compiled
def moved(state: Array, rate: Array, duration: float) -> Array:
    """Return state + rate · duration, shape (17,)."""
    result = np.empty(STATES)
    for i in range(STATES):
        result[i] = state[i] + duration * rate[i]
    return result


@compiled
def on_ground(state: Array) -> Array:
    """Return the state with contact to the ground: the body does not bounce, slip or topple.

    A body at or below z = 0 stands on its legs at once: level, at rest except for an upward velocity, heading kept.
    """
    if state[2] > 0.0:
        return state
    held = np.zeros(STATES)
    held[0], held[1] = state[0], state[1]
    heading = math.sqrt(state[5] ** 2 + state[6] ** 2)
    if heading > 0.0:
        held[5], held[6] = state[5] / heading, state[6] / heading
    else:  # it landed exactly on its back
        held[6] = 1.0
    held[9] = max(0.0, state[9])
    for rotor in range(13, STATES):
        held[rotor] = state[rotor]
    return held


@compiled
def roll_pitch_yaw(state: Array) -> tuple[float, float, float]:
    """Return the attitude as angles in rad (rotations about z, then y, then x); positive pitch is nose down."""
    x, y, z, w = state[3], state[4], state[5], state[6]
    roll = math.atan2(2 * (y * z + x * w), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(1.0, max(-1.0, -2 * (x * z - y * w))))
    return roll, pitch, math.atan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z))


def up(state: Array) -> Array:
    """Return the body's z axis in the world, shape (3,), a unit vector: the direction of the thrust."""
    x, y, z, w = state[3:7].tolist()
    return np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])
