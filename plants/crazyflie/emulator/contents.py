"""Contents of the tables: log variables and parameters, with the names of the real firmware."""

import math
from collections.abc import Callable
from typing import TypeAlias

from plants.crazyflie.emulator.battery import Battery
from plants.crazyflie.emulator.body import Body
from plants.crazyflie.emulator.estimator import StateEstimator
from plants.crazyflie.emulator.lighthouse import Lighthouse
from plants.crazyflie.emulator.log_blocks import Variable
from plants.crazyflie.emulator.parameters import FirmwareParameter, no_effect

Logged: TypeAlias = tuple[str, Callable[[], float]]  # storage format, and function that returns the value
Group: TypeAlias = dict[str, Logged]  # by the name within the group

RSSI = 45  # -dBm
LIGHTHOUSE_METHOD, KALMAN, PID = 1, 2, 1
READY_TIMEOUT, LANDED_TIMEOUT = 30000, 3000  # ms

# Gains of the cascade, with the firmware's defaults (`model.cascade`). Writing them has no effect.
RATE_GAINS = {
    "roll_kp": 250.0, "roll_ki": 500.0, "roll_kd": 2.5, "pitch_kp": 250.0, "pitch_ki": 500.0, "pitch_kd": 2.5,
    "yaw_kp": 120.0, "yaw_ki": 16.7, "yaw_kd": 0.0,
}  # fmt: skip
ATTITUDE_GAINS = {
    "roll_kp": 6.0, "roll_ki": 3.0, "roll_kd": 0.0, "pitch_kp": 6.0, "pitch_ki": 3.0, "pitch_kd": 0.0,
    "yaw_kp": 6.0, "yaw_ki": 1.0, "yaw_kd": 0.35,
}  # fmt: skip
VELOCITY_GAINS = {
    "vxKp": 25.0, "vxKi": 1.0, "vxKd": 0.0, "vyKp": 25.0, "vyKi": 1.0, "vyKd": 0.0, "vzKp": 25.0, "vzKi": 15.0,
    "vzKd": 0.0,
}  # fmt: skip
POSITION_GAINS = {
    "xKp": 2.0, "xKi": 0.0, "xKd": 0.0, "yKp": 2.0, "yKi": 0.0, "yKd": 0.0, "zKp": 2.0, "zKi": 0.5, "zKd": 0.0,
}  # fmt: skip
INTERNAL = ("supervisor.", "system.")  # beginnings of names that may change from release to release
PERSISTENT = ("pid_rate.", "pid_attitude.", "velCtlPid.", "posCtlPid.", "ring.effect")  # beginnings of their names

PARAMETERS = (  # name, storage format, value after power-on
    ("kalman.resetEstimation", "B", 0),
    ("kalman.initialX", "f", 0),
    ("kalman.initialY", "f", 0),
    ("kalman.initialZ", "f", 0),
    ("kalman.initialYaw", "f", 0),
    ("kalman.robustTdoa", "B", 0),
    ("stabilizer.estimator", "B", KALMAN),
    ("stabilizer.controller", "B", PID),
    ("stabilizer.stop", "B", 0),
    ("commander.enHighLevel", "B", 0),
    ("supervisor.infdmp", "B", 0),
    ("supervisor.prefltTimeout", "H", READY_TIMEOUT),
    ("supervisor.landedTimeout", "H", LANDED_TIMEOUT),
    ("supervisor.tmblChckEn", "B", 1),
    ("system.arm", "b", 0),
    ("system.forceArm", "b", 0),
    ("flightmode.althold", "B", 0),
    ("flightmode.poshold", "B", 0),
    ("flightmode.posSet", "B", 0),
    ("flightmode.yawMode", "B", 2),
    ("flightmode.stabModeRoll", "B", 1),
    ("flightmode.stabModePitch", "B", 1),
    ("flightmode.stabModeYaw", "B", 0),
    ("lighthouse.method", "B", LIGHTHOUSE_METHOD),
    ("lighthouse.bsCalibReset", "B", 0),
    ("lighthouse.systemType", "B", 2),
    ("locSrv.extPosStdDev", "f", 0.01),
    ("locSrv.extQuatStdDev", "f", 0.0045),
    ("posCtlPid.xVelMax", "f", 1.0),
    ("posCtlPid.yVelMax", "f", 1.0),
    ("posCtlPid.zVelMax", "f", 1.0),
    ("hlCommander.vtoff", "f", 0.5),
    ("hlCommander.vland", "f", 0.5),
    ("ring.effect", "B", 0),
    ("led.bitmask", "B", 0),
    ("pm.lowVoltage", "f", 3.2),
    *((f"pid_rate.{name}", "f", value) for name, value in RATE_GAINS.items()),
    *((f"pid_attitude.{name}", "f", value) for name, value in ATTITUDE_GAINS.items()),
    *((f"velCtlPid.{name}", "f", value) for name, value in VELOCITY_GAINS.items()),
    *((f"posCtlPid.{name}", "f", value) for name, value in POSITION_GAINS.items()),
    ("deck.bcLighthouse4", "B", 1),
    ("deck.bcFlow2", "B", 0),
    ("deck.bcZRanger2", "B", 0),
    ("deck.bcLoco", "B", 0),
)


def variables_of(
    body: Body, estimator: StateEstimator, battery: Battery, lighthouse: Lighthouse, bits: Callable[[], int]
) -> list[Variable]:
    """Return all variables of the log, which read the given parts of a drone.

    Angles are in deg, pitch positive nose up; group stateEstimateZ is in mm and mm/s.

    Args:
        body: Body of the drone.
        estimator: Its state estimator.
        battery: Its battery.
        lighthouse: Its Lighthouse deck.
        bits: Returns the bits of supervisor and planner.
    """
    groups: dict[str, Group] = {
        **_motion_groups(body, estimator),
        **_power_groups(body, battery),
        "sys": {
            "canfly": ("B", lambda: bits() >> 3 & 1),
            "isFlying": ("B", lambda: bits() >> 4 & 1),
            "isTumbled": ("B", lambda: bits() >> 5 & 1),
        },
        "supervisor": {"info": ("H", bits)},
        "lighthouse": _lighthouse_group(lighthouse),
    }
    return [
        Variable(f"{group}.{name}", layout, value)
        for group, names in groups.items()
        for name, (layout, value) in names.items()
    ]


def _motion_groups(body: Body, estimator: StateEstimator) -> dict[str, Group]:
    """Return the groups of what the estimator knows of the body's motion."""

    def estimate(component: int, scale: float = 1.0) -> Callable[[], float]:
        return lambda: float(estimator.estimate[component]) * scale

    def angle(axis: int) -> Callable[[], float]:
        sign = -1.0 if axis == 1 else 1.0
        return lambda: math.degrees(body.angles[axis]) * sign

    def rate(axis: int) -> Callable[[], float]:
        return lambda: math.degrees(body.rates[axis])

    def variance() -> float:
        return estimator.variance

    attitude: Group = {name: ("f", angle(axis)) for axis, name in enumerate(("roll", "pitch", "yaw"))}
    motion = ("x", "y", "z", "vx", "vy", "vz")
    return {
        "stateEstimate": {**{name: ("f", estimate(k)) for k, name in enumerate(motion)}, **attitude},
        "stateEstimateZ": {name: ("h", estimate(k, 1e3)) for k, name in enumerate(motion)},
        "stabilizer": {**attitude, "thrust": ("f", lambda: float(body.motors.mean()))},
        "kalman": {
            **{f"varP{axis}": ("f", variance) for axis in "XYZ"},
            **{f"state{axis}": ("f", estimate(k)) for k, axis in enumerate("XYZ")},
        },
        "gyro": {name: ("f", rate(axis)) for axis, name in enumerate("xyz")},
    }


def _power_groups(body: Body, battery: Battery) -> dict[str, Group]:
    """Return the groups of battery, radio and motors."""

    def motor(number: int) -> Callable[[], float]:
        return lambda: float(body.motors[number])

    return {
        "pm": {
            "vbat": ("f", lambda: battery.voltage),
            "vbatMV": ("H", lambda: battery.voltage * 1e3),
            "state": ("b", lambda: battery.state),
            "batteryLevel": ("B", lambda: battery.level),
        },
        "radio": {"rssi": ("B", lambda: RSSI)},
        "motor": {f"m{number + 1}": ("H", motor(number)) for number in range(4)},
    }


def _lighthouse_group(lighthouse: Lighthouse) -> Group:
    return {
        "bsReceive": ("H", lambda: lighthouse.received),
        "bsActive": ("H", lambda: lighthouse.logged),
        "bsAvailable": ("H", lambda: 0xFFFF),
        "bsGeoVal": ("H", lambda: lighthouse.geometries),
        "bsCalVal": ("H", lambda: lighthouse.calibrations),
        "bsCalUd": ("H", lambda: 0),
        "bsCalCon": ("H", lambda: lighthouse.received),
        "status": ("B", lambda: lighthouse.status),
    }


def parameters_of(
    *, reset_estimator: Callable[[], None], stop: Callable[[], None], arm: Callable[[bool], object]
) -> list[FirmwareParameter]:
    """Return all parameters. Most of them have no effect.

    Args:
        reset_estimator: Called when kalman.resetEstimation is set to a value other than 0.
        stop: Called when stabilizer.stop is set to a value other than 0.
        arm: Called with each value of system.arm and system.forceArm.
    """

    def set_reset(value: float) -> None:
        if value:
            reset_estimator()

    def set_stop(value: float) -> None:
        if value:
            stop()

    def set_arm(value: float) -> None:
        arm(bool(value))

    effects = {
        "kalman.resetEstimation": set_reset,
        "stabilizer.stop": set_stop,
        "system.arm": set_arm,
        "system.forceArm": set_arm,
    }
    return [
        FirmwareParameter(
            name,
            layout,
            default,
            fixed=name.startswith("deck."),
            changed=effects.get(name, no_effect),
            persistent=name.startswith(PERSISTENT),
            core=not name.startswith(INTERNAL),
        )
        for name, layout, default in PARAMETERS
    ]
