"""Opening the log of an agent: a start that failed does not block the next one."""

from pathlib import Path

import msgpack
import pytest

from dcf_zenoh.errors import RecordingError
from dcf_zenoh.plant import State
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import Recorder, check_unused, open_log


def fail_to_start(folder: Path, remark: str) -> None:
    """Leave the log of an agent that got as far as the phases before the start."""
    with open_log(folder, 1) as stream:
        recorder = Recorder(stream, 1, {"run": "r"})
        recorder.event("inspected", 0, checks=[])
        recorder.end("failed", -1, State(), remark)


def test_empty_log_of_a_failed_start_is_used_again(tmp_path: Path) -> None:
    open_log(tmp_path, 1).close()
    check_unused(tmp_path, 1)
    open_log(tmp_path, 1).close()
    assert [file.name for file in tmp_path.iterdir()] == ["agent-1.msgpack"]


def test_log_of_a_start_that_failed_after_its_header_is_put_aside(tmp_path: Path) -> None:
    for remark in ("battery", "radio"):
        check_unused(tmp_path, 1)
        fail_to_start(tmp_path, remark)
    open_log(tmp_path, 1).close()
    assert (tmp_path / "agent-1.msgpack").read_bytes() == b""
    kept = {}
    for file in tmp_path.glob("*not-started*"):
        end = AgentLog.read(file.read_bytes(), file.name).end
        assert end is not None
        kept[file.name] = end["remark"]
    assert kept == {"agent-1.msgpack.not-started-1": "battery", "agent-1.msgpack.not-started-2": "radio"}


@pytest.mark.parametrize("data", [msgpack.packb({}) + msgpack.packb([0, 1]), msgpack.packb({}) + b"\xc1\xc1"])
def test_log_with_a_step_and_damaged_log_are_kept(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "agent-1.msgpack").write_bytes(data)
    with pytest.raises(RecordingError, match=r"agent-1\.msgpack: there is a log already; choose another directory"):
        check_unused(tmp_path, 1)
    with pytest.raises(RecordingError, match=r"agent-1\.msgpack: there is a log already; choose another directory"):
        open_log(tmp_path, 1)
    assert (tmp_path / "agent-1.msgpack").read_bytes() == data
