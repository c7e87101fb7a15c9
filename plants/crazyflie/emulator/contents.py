"""What is in the tables: the variables of the log and the parameters, by the names that the firmware gives them."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

from plants.crazyflie.emulator.log_blocks import Variable
from plants.crazyflie.emulator.parameters import FirmwareParameter

if TYPE_CHECKING:
    from plants.crazyflie.emulator.firmware import Firmware

Logged: TypeAlias = tuple[str, Callable[[], float]]  # how it is stored, and its value

RSSI = 45  # -dBm
LIGHTHOUSE_METHOD, KALMAN, PID = 1, 2, 1
READY_TIMEOUT, LANDED_TIMEOUT = 30000, 3000  # ms


def variables_of(drone: "Firmware") -> list[Variable]:
    """All variables of the log. Angles are in deg, pitch positive nose up; what ends in Z is in mm and mm/s."""

    def estimate(component: int, scale: float = 1.0) -> float:
        return float(drone.belief.estimate[component]) * scale

    def angle(axis: int) -> float:
        return math.degrees(drone.body.angles[axis]) * (-1.0 if axis == 1 else 1.0)

    def motor(number: int) -> float:
        return float(drone.body.motors[number])

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
        "stabilizer": {**attitude, "thrust": ("f", lambda: float(drone.body.motors.mean()))},
        "kalman": {
            "varPX": ("f", lambda: drone.belief.variance),
            "varPY": ("f", lambda: drone.belief.variance),
            "varPZ": ("f", lambda: drone.belief.variance),
            "stateX": ("f", lambda: estimate(0)),
            "stateY": ("f", lambda: estimate(1)),
            "stateZ": ("f", lambda: estimate(2)),
        },
        "gyro": {
            "x": ("f", lambda: math.degrees(drone.body.rates[0])),
            "y": ("f", lambda: math.degrees(drone.body.rates[1])),
            "z": ("f", lambda: math.degrees(drone.body.rates[2])),
        },
        "pm": {
            "vbat": ("f", lambda: drone.battery.voltage),
            "vbatMV": ("H", lambda: drone.battery.voltage * 1e3),
            "state": ("b", lambda: drone.battery.state),
            "batteryLevel": ("B", lambda: drone.battery.level),
        },
        "radio": {"rssi": ("B", lambda: RSSI)},
        "motor": {
            "m1": ("H", lambda: motor(0)),
            "m2": ("H", lambda: motor(1)),
            "m3": ("H", lambda: motor(2)),
            "m4": ("H", lambda: motor(3)),
        },
        "sys": {
            "canfly": ("B", lambda: drone.bits >> 3 & 1),
            "isFlying": ("B", lambda: drone.bits >> 4 & 1),
            "isTumbled": ("B", lambda: drone.bits >> 5 & 1),
        },
        "supervisor": {"info": ("H", lambda: drone.bits)},
        "lighthouse": {
            "bsReceive": ("H", lambda: drone.lighthouse.received),
            "bsActive": ("H", lambda: drone.lighthouse.active),
            "bsAvailable": ("H", lambda: 0xFFFF),
            "bsGeoVal": ("H", lambda: drone.lighthouse.geometries),
            "bsCalVal": ("H", lambda: drone.lighthouse.calibrations),
            "bsCalUd": ("H", lambda: 0),
            "bsCalCon": ("H", lambda: drone.lighthouse.received),
            "status": ("B", lambda: drone.lighthouse.status),
        },
    }

    return [
        Variable(f"{group}.{name}", layout, value)
        for group, names in groups.items()
        for name, (layout, value) in names.items()
    ]


def parameters_of(drone: "Firmware") -> list[FirmwareParameter]:
    """All parameters. Most of them change nothing; those that do have a function."""

    def reset(value: float) -> None:
        if value:
            drone.belief.reset()
            drone.parameters.reset("kalman.resetEstimation")

    def stop(value: float) -> None:
        if value:
            drone.stop()

    def arm(value: float) -> None:
        drone.arm(bool(value))

    return [
        FirmwareParameter("kalman.resetEstimation", "B", 0, changed=reset),
        FirmwareParameter("kalman.initialX", "f", 0),
        FirmwareParameter("kalman.initialY", "f", 0),
        FirmwareParameter("kalman.initialZ", "f", 0),
        FirmwareParameter("kalman.initialYaw", "f", 0),
        FirmwareParameter("kalman.robustTdoa", "B", 0),
        FirmwareParameter("stabilizer.estimator", "B", KALMAN),
        FirmwareParameter("stabilizer.controller", "B", PID),
        FirmwareParameter("stabilizer.stop", "B", 0, changed=stop),
        FirmwareParameter("commander.enHighLevel", "B", 0),
        FirmwareParameter("supervisor.infdmp", "B", 0),
        FirmwareParameter("supervisor.prefltTimeout", "H", READY_TIMEOUT),
        FirmwareParameter("supervisor.landedTimeout", "H", LANDED_TIMEOUT),
        FirmwareParameter("supervisor.tmblChckEn", "B", 1),
        FirmwareParameter("system.arm", "b", 0, changed=arm),
        FirmwareParameter("system.forceArm", "b", 0, changed=arm),
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
