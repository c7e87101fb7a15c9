"""The firmware of one drone: all its parts, and how they work together while it flies."""

import numpy as np

from dcf_zenoh.plant import Array
from plants.crazyflie.emulator.battery import Battery
from plants.crazyflie.emulator.belief import Belief
from plants.crazyflie.emulator.body import SLOT, Body
from plants.crazyflie.emulator.commander import Commander
from plants.crazyflie.emulator.contents import parameters_of, variables_of
from plants.crazyflie.emulator.crtp import Packet
from plants.crazyflie.emulator.log_blocks import LogBlocks
from plants.crazyflie.emulator.memories import Lighthouse
from plants.crazyflie.emulator.parameters import Parameters
from plants.crazyflie.emulator.planner import Phase, Planner
from plants.crazyflie.emulator.setpoints import STOP, FirmwareSetpoint
from plants.crazyflie.emulator.supervisor import PERIOD, FirmwareSupervisor, Look, SupervisorState
from plants.crazyflie.emulator.truth import SAMPLE, Truth, rounded
from plants.crazyflie.model.vehicle import COMMAND_MAX, Vehicle
from plants.sensing import Sensor

AIRBORNE, SOFT = 0.05, 1.5  # m; m/s with which a touchdown still counts as soft: a drop from 11 cm
STATIONS = {0: (-2.0, 2.0, 2.0), 1: (2.0, -2.0, 2.0)}  # base stations that the drone knows, m


class Firmware:
    """One drone. It knows of no clock, socket or radio: others call `step` when it is time, and `Ports` bring packets.

    Args:
        vehicle: Parameters of its body.
        position: Where it stands, shape (2,), m.
        yaw: Its heading, rad.
        sensor: What measures its position; None: it knows its state exactly.
        rng: Draws the errors of sensing.
        truth: Where it records what it really did. Events: "armed", "disarmed", "arming refused", "took off",
            "motors stopped" (height), "touched down" (speed, soft), "emergency stop", "restarted", and what the
            supervisor thinks whenever that changes, under the name of the state.

    Attributes:
        healthy: It passes its own checks; otherwise it cannot be armed.
        upside_down: It lies or flies on its back.
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
        self.belief = Belief(sensor, self.body.position, rng)
        self.battery = Battery()
        self.lighthouse = Lighthouse(STATIONS)
        self.truth = truth
        self.healthy, self.upside_down = True, False
        self._airborne = False
        self._switch_on()

    @property
    def now(self) -> int:
        """How long it has been flown, ms; it goes on when it is switched off and on."""
        return self.body.tick

    @property
    def bits(self) -> int:
        """What the supervisor tells clients, and in bits 8 to 10 what the planner does."""
        planner = self.planner
        active, finished = planner.phase is not Phase.IDLE, planner.finished(self.now)
        return self.supervisor.bits | active << 8 | finished << 9

    def restart(self) -> None:
        """Switch it off and on: a lock is gone, and so is all that a client has set and not stored."""
        self._switch_on()
        self.lighthouse.restart()
        self.belief.reset()
        self.event("restarted")

    def place(self, position: Array, yaw: float) -> None:
        """Put it on the ground, at `position`, shape (2,), m, with a heading, rad."""
        self.body.place(position, yaw)
        self._airborne = False

    def arm(self, wanted: bool) -> bool:
        """Arm or disarm; whether that was accepted."""
        before = self.supervisor.armed
        accepted = self.supervisor.arm(wanted)
        if not accepted:
            self.event("arming refused")
        elif before != wanted:
            self.event("armed" if wanted else "disarmed")
        return accepted

    def stop(self) -> None:
        """Emergency: no motor turns again until it is switched off and on."""
        self.supervisor.stop()
        self.event("emergency stop")

    def look_around(self) -> None:
        """Let the planner know where it is."""
        self.planner.tell(self.belief.estimate[:3], self.belief.estimate[3:], self.body.angles[2])

    def step(self) -> list[Packet]:
        """Fly for one slot of 10 ms; the packets that it sends of its own accord."""
        self.look_around()
        self.planner.block(not self.supervisor.motors_may_run)
        self.commander.step(self.now)
        if self.now % PERIOD == 0:
            self._look()
        self.body.fly(self._allowed(self.commander.setpoint), self.belief.estimate)
        measured = self.lighthouse.active != 0
        self.belief.step(self.body.position, self.body.velocity, SLOT, measured=measured)
        self.battery.step(self.body.load, SLOT)
        self._observe()
        return self.log.due(self.now)

    def event(self, name: str, **fields: object) -> None:
        """Record something that happened to it."""
        self.truth.write("event", self.now, event=name, **fields)

    def _switch_on(self) -> None:
        self.planner = Planner()
        self.commander = Commander(self.planner)
        self.supervisor = FirmwareSupervisor()
        self.parameters = Parameters(parameters_of(self))
        self.log = LogBlocks(variables_of(self))
        self._ran = False

    def _look(self) -> None:
        """The supervisor looks."""
        before = self.supervisor.state
        seen = Look(
            thrust=self.body.running,
            tumbled=self.upside_down,
            setpoint_age=self.now - self.commander.since,
            healthy=self.healthy,
            ready_timeout=int(self.parameters["supervisor.prefltTimeout"]),
            landed_timeout=int(self.parameters["supervisor.landedTimeout"]),
        )
        self.supervisor.look(seen, self.now)
        if self.supervisor.state is not before:
            self.event(self.supervisor.state.value)

    def _allowed(self, setpoint: FirmwareSetpoint) -> FirmwareSetpoint:
        """What the supervisor makes of a setpoint."""
        if self.supervisor.state is SupervisorState.LEVELLING:
            return setpoint.levelled
        return setpoint if self.supervisor.motors_may_run else STOP

    def _observe(self) -> None:
        """Record what became of the slot."""
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
                estimate=rounded(self.belief.estimate[:3]),
                supervisor=self.supervisor.state.value,
            )
