"""The firmware of one drone: packets in, packets out, and in between it flies."""

import struct
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from dcf_zenoh.plant import Array
from plants.crazyflie_vehicle import COMMAND_MAX, Vehicle
from plants.emulator import crtp
from plants.emulator.battery import Battery
from plants.emulator.belief import Belief
from plants.emulator.body import SLOT, Body
from plants.emulator.commander import Commander
from plants.emulator.contents import parameters_of, variables_of
from plants.emulator.crtp import Packet
from plants.emulator.log_blocks import LogBlocks
from plants.emulator.memories import PERSIST, Lighthouse
from plants.emulator.parameters import Parameters
from plants.emulator.planner import GO_TO, GROUP_MASK, LAND, STOP_PLAN, TAKE_OFF, Phase, Planner
from plants.emulator.setpoints import NAMES, STOP, ByThrust, Setpoint, generic
from plants.emulator.supervisor import PERIOD, Look, State, Supervisor
from plants.emulator.truth import SAMPLE, Truth, rounded
from plants.sensing import Sensor

Handler: TypeAlias = Callable[[int, bytes], list[Packet]]

PROTOCOL, VERSION = 12, b"dcf-zenoh emulator"
NAME = b"Bitcraze Crazyflie".ljust(30, b"\0")  # by which a client knows that it may ask for the protocol's version
ARM, RECOVER, EMERGENCY, FEED, BITS, ANSWER = 0x01, 0x02, 0x03, 0x04, 0x0C, 0x80
AIRBORNE, SOFT = 0.05, 1.5  # m; m/s with which a touchdown still counts as soft: a drop from 11 cm
STATIONS = {0: (-2.0, 2.0, 2.0), 1: (2.0, -2.0, 2.0)}  # base stations that the drone knows, m
HIGH_LEVEL = {GROUP_MASK: "group", STOP_PLAN: "stop_plan", TAKE_OFF: "take_off", LAND: "land", GO_TO: "go_to"}


class Firmware:
    """One drone. It does not know of time, sockets or radio: `receive` and `step` are called at the right instants.

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
        self._handlers: dict[int, Handler] = {
            crtp.LINK: self._link,
            crtp.PLATFORM: self._platform,
            crtp.LOG: self._log,
            crtp.PARAM: self._parameters,
            crtp.MEMORY: self.lighthouse.receive,
            crtp.COMMANDER: self._by_thrust,
            crtp.GENERIC: self._generic,
            crtp.HIGH_LEVEL: self._high_level,
            crtp.SUPERVISOR: self._supervise,
            crtp.LOCALISATION: self._localise,
        }

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

    def receive(self, packet: Packet) -> list[Packet]:
        """Take in a packet; the answers, if there are any. What is not understood is not answered."""
        handler = self._handlers.get(packet.port)
        if handler is None:
            return []
        try:
            return handler(packet.channel, packet.data)
        except (struct.error, IndexError, ValueError):
            return []

    def step(self) -> list[Packet]:
        """Fly for one slot of 10 ms; the packets that it sends of its own accord."""
        self.planner.tell(self.belief.estimate[:3], self.belief.estimate[3:], self.body.angles[2])
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
        self.supervisor = Supervisor()
        self.parameters = Parameters(parameters_of(self))
        self.log = LogBlocks(variables_of(self))
        self._thrust = ByThrust()
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

    def _allowed(self, setpoint: Setpoint) -> Setpoint:
        """What the supervisor makes of a setpoint."""
        if self.supervisor.state is State.LEVELLING:
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

    def _command(self, name: str, *values: float) -> None:
        """Record a command of a client."""
        self.truth.write("command", self.now, command=name, values=rounded(values))

    def _follow(self, setpoint: Setpoint, name: str) -> None:
        self._command(name, *setpoint.values)
        self.commander.follow(setpoint, self.now)

    def _link(self, channel: int, data: bytes) -> list[Packet]:
        if channel == 0:
            return [Packet(crtp.LINK, 0, data)]
        return [Packet(crtp.LINK, 1, NAME)] if channel == 1 else []

    def _log(self, channel: int, data: bytes) -> list[Packet]:
        return self.log.receive(channel, data, self.now)

    def _parameters(self, channel: int, data: bytes) -> list[Packet]:
        return self.parameters.receive(channel, data)

    def _platform(self, channel: int, data: bytes) -> list[Packet]:
        if channel == 1:
            answers = {0: bytes((PROTOCOL,)), 1: VERSION, 2: b"CF21"}
            return [Packet(crtp.PLATFORM, 1, data[:1] + answers.get(data[0], b""))]
        if channel == 0 and data[0] in (ARM, RECOVER):  # as it was before protocol version 12
            return [Packet(crtp.PLATFORM, 0, data[:1] + self._arm_or_recover(data)[1:])]
        return []

    def _supervise(self, channel: int, data: bytes) -> list[Packet]:
        if channel == 0:
            if data[0] == BITS:
                return [Packet(crtp.SUPERVISOR, 0, struct.pack("<BH", BITS | ANSWER, self.bits))]
            if 1 <= data[0] < BITS:
                return [Packet(crtp.SUPERVISOR, 0, bytes((data[0] | ANSWER, self.bits >> data[0] - 1 & 1)))]
            return []
        if data[0] in (ARM, RECOVER):
            return [Packet(crtp.SUPERVISOR, 1, self._arm_or_recover(data))]
        self._safeguard(data[0])
        return []

    def _arm_or_recover(self, data: bytes) -> bytes:
        """What the answer says."""
        if data[0] == RECOVER:
            self._command("recover")
            accepted = self.supervisor.recover()
            return bytes((RECOVER | ANSWER, accepted, accepted))
        wanted = bool(data[1])
        self._command("arm" if wanted else "disarm")
        accepted = self.arm(wanted)
        return bytes((ARM | ANSWER, accepted, self.supervisor.armed))

    def arm(self, wanted: bool) -> bool:
        """Arm or disarm; whether that was accepted."""
        before = self.supervisor.armed
        accepted = self.supervisor.arm(wanted)
        if not accepted:
            self.event("arming refused")
        elif before != wanted:
            self.event("armed" if wanted else "disarmed")
        return accepted

    def _safeguard(self, kind: int) -> None:
        if kind == EMERGENCY:
            self._command("emergency_stop")
            self.supervisor.stop()
            self.event("emergency stop")
        elif kind == FEED:
            self.supervisor.feed(self.now)

    def _by_thrust(self, channel: int, data: bytes) -> list[Packet]:
        if channel == 0:
            self._follow(self._thrust.setpoint(data), "roll_pitch_yaw_thrust")
        return []

    def _generic(self, channel: int, data: bytes) -> list[Packet]:
        if channel == 0:
            setpoint = generic(data)
            if setpoint is not None:
                self._follow(setpoint, NAMES[setpoint.mode])
        elif channel == 1 and data[0] == 0:
            self._command("relax")
            self.commander.relax()
            self.planner.tell(self.belief.estimate[:3], self.belief.estimate[3:], self.body.angles[2])
        return []

    def _high_level(self, channel: int, data: bytes) -> list[Packet]:
        error = self.planner.command(data, self.now)
        name, width = HIGH_LEVEL.get(data[0], "unknown"), len(data) // 4 * 4
        self._command(name, *(struct.unpack(f"<{width // 4}f", data[-width:]) if name in ("take_off", "land") else ()))
        return [Packet(crtp.HIGH_LEVEL, channel, data[:3].ljust(3, b"\0") + bytes((error,)))]

    def _localise(self, channel: int, data: bytes) -> list[Packet]:
        if channel == 0:
            self.belief.told(np.array(struct.unpack("<3f", data)))
        elif data[0] == 8:
            self.belief.told(np.array(struct.unpack("<7f", data[1:])[:3]))
        elif data[0] == PERSIST:
            return self.lighthouse.persist(data)
        elif data[0] in (EMERGENCY, FEED):  # as it was before protocol version 12
            self._safeguard(data[0])
        return []
