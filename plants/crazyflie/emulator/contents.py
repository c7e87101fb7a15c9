"""Contents of the tables: log variables and parameters, with the names of the real firmware."""

import math
from collections.abc import Callable
from typing import TypeAlias

from plants.crazyflie.emulator.battery import Battery
from plants.crazyflie.emulator.body import Body
from plants.crazyflie.emulator.estimator import StateEstimator
from plants.crazyflie.emulator.log_blocks import Variable
from plants.crazyflie.emulator.memories import Lighthouse
from plants.crazyflie.emulator.parameters import FirmwareParameter

Logged: TypeAlias = tuple[str, Callable[[], float]]  # storage format, and function that returns the value

RSSI = 45  # -dBm
LIGHTHOUSE_METHOD, KALMAN, PID = 1, 2, 1
READY_TIMEOUT, LANDED_TIMEOUT = 30000, 3000  # ms


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

    def estimate(component: int, scale: float = 1.0) -> float:
        return float(estimator.estimate[component]) * scale

    def angle(axis: int) -> float:
        return math.degrees(body.angles[axis]) * (-1.0 if axis == 1 else 1.0)

    def motor(number: int) -> float:
        return float(body.motors[number])

    attitude: dict[str, Logged] = {
        "roll": ("f", lambda: angle(0)),
        "pitch": ("f", lambda: angle(1)),
        "yaw": ("f", lambda: angle(2)),
    }
    groups: dict[str, dict[str, Logged]] = {
        "stateEstimate": {
            "x": ("f", lambda: estimate(0)),
            "y": ("f", lambda: estimate(1)),
            "z": ("f", lambda: estimate(2)),
            "vx": ("f", lambda: estimate(3)),
            "vy": ("f", lambda: estimate(4)),
            "vz": ("f", lambda: estimate(5)),
            **attitude,
        },
        "stateEstimateZ": {
            "x": ("h", lambda: estimate(0, 1e3)),
            "y": ("h", lambda: estimate(1, 1e3)),
            "z": ("h", lambda: estimate(2, 1e3)),
            "vx": ("h", lambda: estimate(3, 1e3)),
            "vy": ("h", lambda: estimate(4, 1e3)),
            "vz": ("h", lambda: estimate(5, 1e3)),
        },
        "stabilizer": {**attitude, "thrust": ("f", lambda: float(body.motors.mean()))},
        "kalman": {
            "varPX": ("f", lambda: estimator.variance),
            "varPY": ("f", lambda: estimator.variance),
            "varPZ": ("f", lambda: estimator.variance),
            "stateX": ("f", lambda: estimate(0)),
            "stateY": ("f", lambda: estimate(1)),
            "stateZ": ("f", lambda: estimate(2)),
        },
        "gyro": {
            "x": ("f", lambda: math.degrees(body.rates[0])),
            "y": ("f", lambda: math.degrees(body.rates[1])),
            "z": ("f", lambda: math.degrees(body.rates[2])),
        },
        "pm": {
            "vbat": ("f", lambda: battery.voltage),
            "vbatMV": ("H", lambda: battery.voltage * 1e3),
            "state": ("b", lambda: battery.state),
            "batteryLevel": ("B", lambda: battery.level),
        },
        "radio": {"rssi": ("B", lambda: RSSI)},
        "motor": {
            "m1": ("H", lambda: motor(0)),
            "m2": ("H", lambda: motor(1)),
            "m3": ("H", lambda: motor(2)),
            "m4": ("H", lambda: motor(3)),
        },
        "sys": {
            "canfly": ("B", lambda: bits() >> 3 & 1),
            "isFlying": ("B", lambda: bits() >> 4 & 1),
            "isTumbled": ("B", lambda: bits() >> 5 & 1),
        },
        "supervisor": {"info": ("H", bits)},
        "lighthouse": {
            "bsReceive": ("H", lambda: lighthouse.received),
            "bsActive": ("H", lambda: lighthouse.logged),
            "bsAvailable": ("H", lambda: 0xFFFF),
            "bsGeoVal": ("H", lambda: lighthouse.geometries),
            "bsCalVal": ("H", lambda: lighthouse.calibrations),
            "bsCalUd": ("H", lambda: 0),
            "bsCalCon": ("H", lambda: lighthouse.received),
            "status": ("B", lambda: lighthouse.status),
        },
    }

    return [
        Variable(f"{group}.{name}", layout, value)
        for group, names in groups.items()
        for name, (layout, value) in names.items()
    ]


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

    return [
        FirmwareParameter("kalman.resetEstimation", "B", 0, changed=set_reset),
        FirmwareParameter("kalman.initialX", "f", 0),
        FirmwareParameter("kalman.initialY", "f", 0),
        FirmwareParameter("kalman.initialZ", "f", 0),
        FirmwareParameter("kalman.initialYaw", "f", 0),
        FirmwareParameter("kalman.robustTdoa", "B", 0),
        FirmwareParameter("stabilizer.estimator", "B", KALMAN),
        FirmwareParameter("stabilizer.controller", "B", PID),
        FirmwareParameter("stabilizer.stop", "B", 0, changed=set_stop),
        FirmwareParameter("commander.enHighLevel", "B", 0),
        FirmwareParameter("supervisor.infdmp", "B", 0),
        FirmwareParameter("supervisor.prefltTimeout", "H", READY_TIMEOUT),
        FirmwareParameter("supervisor.landedTimeout", "H", LANDED_TIMEOUT),
        FirmwareParameter("supervisor.tmblChckEn", "B", 1),
        FirmwareParameter("system.arm", "b", 0, changed=set_arm),
        FirmwareParameter("system.forceArm", "b", 0, changed=set_arm),
        FirmwareParameter("flightmode.althold", "B", 0),
        FirmwareParameter("flightmode.poshold", "B", 0),
        FirmwareParameter("flightmode.posSet", "B", 0),
        FirmwareParameter("flightmode.yawMode", "B", 2),
        FirmwareParameter("flightmode.stabModeRoll", "B", 1),
        FirmwareParameter("flightmode.stabModePitch", "B", 1),
        FirmwareParameter("flightmode.stabModeYaw", "B", 0),
        FirmwareParameter("lighthouse.method", "B", LIGHTHOUSE_METHOD),
        FirmwareParameter("lighthouse.bsCalibReset", "B", 0),
        FirmwareParameter("lighthouse.systemType", "B", 2),
        FirmwareParameter("locSrv.extPosStdDev", "f", 0.01),
        FirmwareParameter("locSrv.extQuatStdDev", "f", 0.0045),
        FirmwareParameter("posCtlPid.xVelMax", "f", 1.0),
        FirmwareParameter("posCtlPid.yVelMax", "f", 1.0),
        FirmwareParameter("posCtlPid.zVelMax", "f", 1.0),
        FirmwareParameter("hlCommander.vtoff", "f", 0.5),
        FirmwareParameter("hlCommander.vland", "f", 0.5),
        FirmwareParameter("ring.effect", "B", 0),
        FirmwareParameter("led.bitmask", "B", 0),
        FirmwareParameter("pm.lowVoltage", "f", 3.2),
        FirmwareParameter("deck.bcLighthouse4", "B", 1, fixed=True),
        FirmwareParameter("deck.bcFlow2", "B", 0, fixed=True),
        FirmwareParameter("deck.bcZRanger2", "B", 0, fixed=True),
        FirmwareParameter("deck.bcLoco", "B", 0, fixed=True),
    ]
