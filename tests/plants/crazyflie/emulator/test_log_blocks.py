"""Log blocks: limits, errors, and how values are packed."""

import errno
import struct

import numpy as np
import pytest

from plants.crazyflie.emulator.crtp import LOG
from plants.crazyflie.emulator.log_blocks import APPEND, CONTROL, CREATE, DELETE, START, STOP, LogBlocks, Variable


def blocks(count: int = 8) -> LogBlocks:
    return LogBlocks([Variable(f"group.v{k}", "f", lambda k=k: 1.5 * k) for k in range(count)])  # type: ignore[misc]


def control(of: LogBlocks, *data: int, now: int = 0) -> int:
    """The error number of a command."""
    (answer,) = of.receive(CONTROL, bytes(data), now)
    assert (answer.port, answer.channel, *answer.data[:2]) == (LOG, CONTROL, *data[:2])
    return answer.data[2]


def variables(*numbers: int, kind: int = 0x77) -> list[int]:
    return [byte for number in numbers for byte in (kind, *struct.pack("<H", number))]


def test_block_is_sent_at_its_period_with_the_time_in_three_bytes() -> None:
    of = blocks()
    assert control(of, CREATE, 7, *variables(1, 2)) == 0
    assert control(of, START, 7, 5, now=0x1FFFFC4) == 0
    sent = [(now, packet) for now in range(0x1FFFFC4, 0x1FFFFC4 + 200, 10) for packet in of.due(now)]
    assert [now - 0x1FFFFC4 for now, _ in sent] == [50, 100, 150]
    number, low, middle, high, *values = struct.unpack("<4B2f", sent[0][1].data)
    assert (number, low | middle << 8 | high << 16) == (7, (0x1FFFFC4 + 50) & 0xFFFFFF)
    assert values == [1.5, 3.0]


def test_missed_periods_are_not_made_up_for() -> None:
    of = blocks()
    control(of, CREATE, 1, *variables(0))
    control(of, START, 1, 1)
    assert len(of.due(95)) == 1
    assert of.due(99) == []
    assert len(of.due(100)) == 1


def test_stopped_and_deleted_blocks_are_silent() -> None:
    of = blocks()
    control(of, CREATE, 1, *variables(0))
    control(of, START, 1, 1)
    assert control(of, STOP, 1) == 0
    assert of.due(1000) == []
    assert control(of, DELETE, 1) == 0
    assert control(of, DELETE, 1) == errno.ENOENT


def test_limits_and_mistakes_have_their_error_numbers() -> None:
    of = blocks(200)
    assert control(of, CREATE, 1, *variables(0, 1, 2, 3, 4, 5)) == 0
    assert control(of, CREATE, 1, *variables(0)) == errno.EEXIST
    assert control(of, APPEND, 1, *variables(6)) == errno.E2BIG  # 28 bytes
    assert control(of, APPEND, 1, *variables(6, kind=0x78)) == 0  # 26
    assert control(of, APPEND, 2, *variables(6)) == errno.ENOENT
    assert control(of, CREATE, 2, *variables(200)) == errno.ENOENT
    assert control(of, 99, 1) == errno.ENOEXEC
    for number in range(2, 17):
        assert control(of, CREATE, number, *variables(0)) == 0
    assert control(of, CREATE, 17, *variables(0)) == errno.ENOMEM
    many = blocks(200)
    for number in range(10):
        assert control(many, CREATE, number, *variables(*range(12), kind=0x71)) == 0
    assert control(many, CREATE, 10, *variables(*range(12), kind=0x71)) == errno.ENOMEM  # more than 128


@pytest.mark.parametrize(
    ("layout", "value", "packed"),
    [
        ("f", 0.1, np.float32(0.1).tobytes()),
        ("e", 0.1, np.float16(0.1).tobytes()),
        ("B", 300.0, b"\x2c"),
        ("b", -1.0, b"\xff"),
        ("h", -1234.6, struct.pack("<h", -1234)),
        ("I", 70000.0, struct.pack("<I", 70000)),
    ],
)
def test_values_are_packed_as_asked_for(layout: str, value: float, packed: bytes) -> None:
    codes = {"B": 1, "H": 2, "I": 3, "b": 4, "h": 5, "i": 6, "f": 7, "e": 8}
    of = LogBlocks([Variable("group.value", "f", lambda: value)])
    control(of, CREATE, 1, *variables(0, kind=0x70 | codes[layout]))
    control(of, START, 1, 1)
    (packet,) = of.due(10)
    assert packet.data[4:] == packed
