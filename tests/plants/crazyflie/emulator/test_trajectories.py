"""Trajectories in the drone's memory, packed by cflib, against the curves that they stand for."""

import errno
import math
import struct
from itertools import pairwise

import numpy as np
import pytest
from cflib.crazyflie.high_level_commander import HighLevelCommander
from cflib.crazyflie.mem.trajectory_memory import CompressedSegment, CompressedStart, Poly4D

from dcf_zenoh.plant import Array
from plants.crazyflie.emulator.memories import Memories, TestMemory, TrajectoryMemory
from plants.crazyflie.emulator.planner import Phase, Planner
from plants.crazyflie.emulator.setpoints import STOP

COMPRESSED = HighLevelCommander.TRAJECTORY_TYPE_POLY4D_COMPRESSED
OFFSET = 12


class Client:
    """High-level commander of cflib whose packets go to a planner directly."""

    def __init__(self, *parts: Poly4D | CompressedStart | CompressedSegment, version: int = 12) -> None:
        self.memory = TrajectoryMemory()
        self.memory.write(OFFSET, b"".join(bytes(each.pack()) for each in parts))
        self.planner = Planner(self.memory.content)
        self.planner.block(False)
        self.now = 0
        self.errors: list[int] = []
        self.platform = self
        self.version = version
        self.commander = HighLevelCommander(self)

    def get_protocol_version(self) -> int:
        return self.version

    def send_packet(self, packet: object) -> None:
        self.errors.append(self.planner.command(bytes(packet.data), self.now))  # type: ignore[attr-defined]

    def at(self, now: int) -> Array:
        return np.array(self.planner.setpoint(now).values)


def poly(duration: float, **axes: list[float]) -> Poly4D:
    made = Poly4D(duration)
    for axis in ("x", "y", "z", "yaw"):
        setattr(made, axis, Poly4D.Poly([*axes.get(axis, []), *[0.0] * 8][:8]))
    return made


def two_pieces(version: int = 12) -> Client:
    """x = 1 + t² for 1 s, then x = 2 + 2 t for 2 s; y = 3, z = 0.5 + t / 4, yaw = t / 10 without a jump."""
    first = poly(1.0, x=[1, 0, 1], y=[3.0], z=[0.5, 0.25], yaw=[0.0, 0.1])
    second = poly(2.0, x=[2, 2], y=[3.0], z=[0.75, 0.25], yaw=[0.1, 0.1])
    client = Client(first, second, version=version)
    client.commander.define_trajectory(4, OFFSET, 2)
    return client


@pytest.mark.parametrize("version", [9, 12])
def test_pieces_follow_each_other_and_the_last_point_is_held(version: int) -> None:
    client = two_pieces(version)
    client.commander.start_trajectory(4)
    assert client.errors == [0, 0]
    assert client.planner.phase is Phase.FLYING
    assert client.at(0) == pytest.approx([1, 3, 0.5, 0])
    assert client.at(500) == pytest.approx([1.25, 3, 0.625, 0.05])
    assert client.at(2000) == pytest.approx([4, 3, 1.0, 0.2])
    assert not client.planner.finished(2990)
    for now in (3000, 9000):
        assert client.at(now) == pytest.approx([6, 3, 1.25, 0.3])
        assert client.planner.finished(now)


def test_time_is_stretched_and_reversed() -> None:
    client = two_pieces()
    client.commander.start_trajectory(4, time_scale=2.0, reversed=True)
    assert client.at(0) == pytest.approx([6, 3, 1.25, 0.3])
    assert client.at(2000) == pytest.approx([4, 3, 1.0, 0.2])  # a third of the way back
    assert client.at(5000) == pytest.approx([1.25, 3, 0.625, 0.05])
    assert client.at(6000) == pytest.approx([1, 3, 0.5, 0])
    assert client.planner.finished(6000)


def test_a_relative_trajectory_begins_where_the_drone_is() -> None:
    client = two_pieces()
    client.planner.set_state(np.array([-1.0, 0.0, 0.2]), np.zeros(3), math.pi / 2)
    client.commander.start_trajectory(4, relative_position=True)
    assert client.at(500) == pytest.approx([-0.75, 0.0, 0.325, 0.05])
    client = two_pieces()
    client.planner.set_state(np.array([-1.0, 0.0, 0.2]), np.zeros(3), math.pi / 2)
    client.commander.start_trajectory(4, relative_position=True, relative_yaw=True)
    assert client.at(500) == pytest.approx([-1.0, 0.25, 0.325, 0.05 + math.pi / 2])


def bezier(points: list[float], s: float) -> float:
    """Point of a Bézier curve by de Casteljau's algorithm."""
    while len(points) > 1:
        points = [(1 - s) * a + s * b for a, b in pairwise(points)]
    return points[0]


def test_a_compressed_trajectory_is_made_of_bezier_curves() -> None:
    seven = [0.1, 0.4, -0.2, 0.3, 0.9, 0.8, 0.7]
    client = Client(
        CompressedStart(0.1, 0.2, 0.5, 0.0),
        CompressedSegment(0.5, [0.6], [], [0.7, 0.9, 1.0], [math.radians(90)]),
        CompressedSegment(2.0, seven, [0.0], [], []),
    )
    client.commander.define_trajectory(0, OFFSET, 2, COMPRESSED)
    client.commander.start_trajectory(0)
    quarter = [0.35, 0.2, bezier([0.5, 0.7, 0.9, 1.0], 0.5), math.radians(45)]
    assert client.at(250) == pytest.approx(quarter, abs=1e-4)
    later = [bezier([0.6, *seven], 0.3), bezier([0.2, 0.0], 0.3), 1.0, math.radians(90)]
    assert client.at(500 + 600) == pytest.approx(later, abs=1e-4)
    assert client.planner.finished(2500)
    client.commander.start_trajectory(0, reversed=True)
    client.commander.start_trajectory(0, time_scale=0.5)
    assert client.errors == [0, 0, errno.ENOEXEC, errno.ENOEXEC]


def test_what_was_not_defined_or_is_not_in_the_memory_does_not_fly() -> None:
    client = two_pieces()
    client.commander.start_trajectory(5)
    client.commander.define_trajectory(10, 0, 1)
    client.commander.define_trajectory(5, 4000, 1)
    client.commander.start_trajectory(5)
    client.planner.block(True)
    client.commander.start_trajectory(4)
    assert client.errors == [0, 0, errno.ENOEXEC, 0, 0, errno.EBUSY]
    assert client.planner.setpoint(0) == STOP


def test_take_off_and_landing_at_a_velocity_take_as_long_as_that_takes() -> None:
    planner = Planner()
    planner.block(False)
    assert planner.command(struct.pack("<BBf?f?f", 9, 0, 1.0, False, 0.0, True, 0.25), 0) == 0
    assert not planner.finished(3990)
    assert planner.finished(4000)
    planner.setpoint(4000)
    assert planner.command(struct.pack("<BBf?f?f", 10, 0, 0.9, True, 0.0, True, 0.0), 4000) == 0
    assert not planner.finished(4000 + 1790)  # 0.9 m at the default of 0.5 m/s
    assert planner.setpoint(4000 + 1790).values[2] == pytest.approx(0.1, abs=1e-3)
    assert planner.finished(4000 + 1800)


def test_memories_are_listed_read_and_written_within_their_bounds() -> None:
    trajectory = TrajectoryMemory()
    memories = Memories((TestMemory(), trajectory))
    assert memories.receive(0, bytes((1,)))[0].data == bytes((1, 2))
    assert memories.receive(0, bytes((2, 1)))[0].data == struct.pack("<BBBI8x", 2, 1, 0x12, 0x1000)
    assert memories.receive(1, struct.pack("<BIB", 0, 254, 4))[0].data[5:] == bytes((0, 254, 255, 0, 1))
    assert memories.receive(2, struct.pack("<BI", 1, 4094) + b"ab")[0].data[5] == 0
    assert trajectory.read(4093, 3) == b"\0ab"
    assert memories.receive(2, struct.pack("<BI", 1, 4095) + b"ab")[0].data[5] == errno.EIO
    assert memories.receive(1, struct.pack("<BIB", 2, 0, 1))[0].data[5] == errno.ENOENT
