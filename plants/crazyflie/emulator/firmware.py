"""Firmware of one drone: its parts and their interplay in flight."""

import numpy as np

from dcf_zenoh.plant import Array
from plants.crazyflie.emulator.battery import Battery
from plants.crazyflie.emulator.body import SLOT, Body
from plants.crazyflie.emulator.commander import Commander
from plants.crazyflie.emulator.contents import parameters_of, variables_of
from plants.crazyflie.emulator.crtp import CONSOLE, DATA_MAX, Packet
from plants.crazyflie.emulator.estimator import StateEstimator
from plants.crazyflie.emulator.lighthouse import Lighthouse
from plants.crazyflie.emulator.log_blocks import LogBlocks
from plants.crazyflie.emulator.memories import Memories, TestMemory, TrajectoryMemory
from plants.crazyflie.emulator.parameters import Parameters
from plants.crazyflie.emulator.planner import Phase, Planner
from plants.crazyflie.emulator.setpoints import STOP, FirmwareSetpoint
from plants.crazyflie.emulator.supervisor import CAN_FLY, PERIOD, FirmwareSupervisor, Observation, SupervisorState
from plants.crazyflie.emulator.truth import SAMPLE, Truth, rounded
from plants.crazyflie.model.vehicle import COMMAND_MAX, Vehicle
from plants.sensing import Sensor

SAID = (SupervisorState.FREE_FALL, SupervisorState.LOCKED, SupervisorState.CRASHED)  # states told on the console
AIRBORNE, SOFT = 0.05, 1.5  # m; m/s up to which a touchdown counts as soft: a fall of 11 cm
STATIONS = {0: (-2.0, 2.0, 2.0), 1: (2.0, -2.0, 2.0)}  # positions of the base stations in the drone's memory, m


class Firmware:
    """Firmware and body of one drone, without clock, socket or radio: `Drone` calls `step`, `Ports` passes packets.

    Args:
        vehicle: Parameters of the body.
        position: Initial position on the ground, shape (2,), m.
        yaw: Initial heading, rad.
        sensor: Positioning system; None: the estimate is exact.
        rng: Source of the errors of sensing.
        truth: Recorder of the true flight. Events: "armed", "disarmed", "arming refused", "took off",
            "motors stopped" (height), "touched down" (speed, soft), "emergency stop", "restarted", and the name of the
            supervisor's state whenever it changes.

    Attributes:
        healthy: The drone passes its own checks; otherwise it cannot be armed.
        automatic: It arms itself whenever it can be armed, as the firmware of brushed Crazyflies does.
        listened: A client receives the text of the console; it is kept until there is one.
        upside_down: The drone lies or flies on its back.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        position: Array,
        yaw: float,
        *,
        sensor: Sensor | None,
        rng: np.random.Generator,
        truth: Truth,
    ) -> None:
        self.body = Body(vehicle, position, yaw)
        self.estimator = StateEstimator(sensor, self.body.position, rng)
        self.battery = Battery()
        self.lighthouse = Lighthouse(STATIONS)
        self.truth = truth
        self.healthy, self.upside_down, self.automatic, self.listened = True, False, False, False
        self._text = b""
        self._airborne = False
        self._stored: dict[str, float] = {}  # persistent parameters
        self._switch_on()

    @property
    def now(self) -> int:
        """Simulated time, ms; it continues when the drone is switched off and on."""
        return self.body.tick

    @property
    def bits(self) -> int:
        """Bits for clients: of the supervisor, of the planner (8 and 9), and of a fault of a deck (11)."""
        planner = self.planner
        active, finished = planner.phase is not Phase.IDLE, planner.finished(self.now)
        fault = self.lighthouse.faulty
        return self.supervisor.bits & ~(fault * CAN_FLY) | active << 8 | finished << 9 | fault << 11

    @property
    def motors_may_run(self) -> bool:
        """Whether setpoints reach the motors."""
        return self.supervisor.motors_may_run and not self.lighthouse.faulty

    def restart(self) -> None:
        """Switch the drone off and on: this clears a lock, and all settings that a client has not stored."""
        self._switch_on()
        self.lighthouse.restart()
        self.estimator.reset()
        self.event("restarted")

    def place(self, position: Array, yaw: float) -> None:
        """Put the drone on the ground, at `position`, shape (2,), m, with a heading, rad."""
        self.body.place(position, yaw)
        self._airborne = False

    def arm(self, wanted: bool) -> bool:
        """Arm or disarm; return whether that was accepted."""
        before = self.supervisor.armed
        accepted = self.supervisor.arm(wanted)
        if not accepted:
            self.event("arming refused")
        elif before != wanted:
            self.event("armed" if wanted else "disarmed")
        return accepted

    def stop(self) -> None:
        """Stop in an emergency: the motors stay off until the drone is switched off and on."""
        self.supervisor.stop()
        self.event("emergency stop")

    def refresh_planner(self) -> None:
        """Pass the present estimate to the planner."""
        self.planner.set_state(self.estimator.estimate[:3], self.estimator.estimate[3:], self.body.angles[2])

    def step(self) -> list[Packet]:
        """Simulate one slot of 10 ms; return the log packets that are due."""
        self.refresh_planner()
        self.planner.block(not self.motors_may_run)
        self.commander.step(self.now)
        if self.now % PERIOD == 0:
            self._update_supervisor()
        self.body.fly(self._allowed(self.commander.setpoint), self.estimator.estimate, self.estimator.tilt_error)
        self.lighthouse.step(self.now)
        measured = self.lighthouse.active != 0
        self.estimator.step(self.body.position, self.body.velocity, self.body.up, SLOT, measured=measured)
        self.battery.step(self.body.load, SLOT)
        self._record()
        return [*self.log.due(self.now), *(self._console() if self.listened else [])]

    def say(self, line: str) -> None:
        """Write a line to the console of clients."""
        self._text += line.encode() + b"\n"

    def _console(self) -> list[Packet]:
        """Return the next part of the console's text."""
        part, self._text = self._text[:DATA_MAX], self._text[DATA_MAX:]
        return [Packet(CONSOLE, 0, part)] if part else []

    def event(self, name: str, **fields: object) -> None:
        """Record an event."""
        self.truth.write("event", self.now, event=name, **fields)

    def _switch_on(self) -> None:
        trajectories = TrajectoryMemory()
        self.planner = Planner(trajectories.content)
        self.memories = Memories((self.lighthouse, TestMemory(), trajectories))
        self.commander = Commander(self.planner)
        self.supervisor = FirmwareSupervisor()
        self.say("SYS: emulated Crazyflie 2.1 is up and running!")
        self.say("ESTIMATOR: Using Kalman (2) estimator")
        self.say("CONTROLLER: Using PID (1) controller")
        parameters = parameters_of(reset_estimator=self._reset_estimator, stop=self.stop, arm=self.arm)
        self.parameters = Parameters(parameters, self._stored)
        self.log = LogBlocks(variables_of(self.body, self.estimator, self.battery, self.lighthouse, lambda: self.bits))
        self._ran = False

    def _reset_estimator(self) -> None:
        self.estimator.reset()
        self.parameters.reset("kalman.resetEstimation")

    def _update_supervisor(self) -> None:
        """Update the supervisor, and record a change of its state."""
        before = self.supervisor.state
        observation = Observation(
            thrust=self.body.running,
            tumbled=self.upside_down,
            setpoint_age=self.now - self.commander.since,
            healthy=self.healthy and not self.lighthouse.faulty,
            ready_timeout=int(self.parameters["supervisor.prefltTimeout"]),
            landed_timeout=int(self.parameters["supervisor.landedTimeout"]),
        )
        self.supervisor.automatic = self.automatic
        armed = self.supervisor.armed
        self.supervisor.update(observation, self.now)
        if self.supervisor.armed and not armed:
            self.event("armed")
        if self.supervisor.state is not before:
            self.event(self.supervisor.state.value)
            if self.supervisor.state in SAID:
                self.say(f"SUP: {self.supervisor.state.value}")

    def _allowed(self, setpoint: FirmwareSetpoint) -> FirmwareSetpoint:
        """Return the setpoint that the supervisor allows instead of `setpoint`."""
        if self.supervisor.state is SupervisorState.LEVELLING and self.motors_may_run:
            return setpoint.level
        return setpoint if self.motors_may_run else STOP

    def _record(self) -> None:
        """Record the events and the state after a slot."""
        body, running = self.body, self.body.running
        height = float(body.position[2])
        if not self._airborne and height > AIRBORNE:
            self._airborne = True
            self.event("took off")
        if self._ran and not running and self._airborne and body.in_the_air:
            self.event("motors stopped", height=round(height, 3))
        self._ran = running
        if body.touchdown is not None and self._airborne:
            self._airborne = False
            self.event("touched down", speed=round(body.touchdown, 3), soft=body.touchdown <= SOFT)
        if self.truth.kept and self.now % SAMPLE == 0:
            self.truth.write(
                "state",
                self.now,
                position=rounded(body.position),
                velocity=rounded(body.velocity),
                angles=rounded(body.angles),
                motors=rounded(body.motors / COMMAND_MAX),
                estimate=rounded(self.estimator.estimate[:3]),
                supervisor=self.supervisor.state.value,
            )
