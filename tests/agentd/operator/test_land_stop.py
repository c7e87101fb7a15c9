"""Flights of real daemons that an operator or a signal ends: every body comes down."""

import fcntl
import json
import os
import signal
import subprocess
import sys
import termios
from contextlib import suppress
from pathlib import Path

import pytest

from agentd.daemon import end_requests, operator_protocol
from dcf_zenoh import Run
from tests.support.bodies import PHASES, Sandbox
from tests.support.daemons import PROCESSES, Launch
from tests.support.waiting import until

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.whole_fleet,
    pytest.mark.skipif(not (PROCESSES / "self").exists(), reason="processes are found in /proc"),
]

WALL = ["time.clock='wall'", "time.duration=60.0"]
REAL = "landing_time = 1.0"


@pytest.fixture
def sandbox(tmp_path: Path) -> Sandbox:
    found = Sandbox(tmp_path)
    found.write(duration=60.0)
    return found


def agentd(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "agentd", *words]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=30)


def check_all_landed(sandbox: Sandbox, folder: Path, why: str) -> None:
    for agent in (1, 2, 3):
        assert sandbox.of(agent)[-2:] == ["finish stopped", "close"]
    for log in Run.read(folder).agents.values():
        assert log.end is not None
        assert log.end["end"] == "stopped"
        assert log.end["remark"] == why


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.large), signal.SIGTERM])
def test_signal_to_the_launcher_lands_all_bodies_although_that_takes_longer_than_its_patience(
    sandbox: Sandbox, tmp_path: Path, number: signal.Signals
) -> None:
    slow = ["plants.body.lands_in=36", "plants.body.pauses=5"]  # 3.6 s
    (tmp_path / "body.py").write_text((tmp_path / "body.py").read_text().replace(REAL, "landing_time = 8.0"))
    with Launch(sandbox.file, tmp_path / "run", *WALL, *slow) as launch:
        until(lambda: len([1 for _, what in sandbox.entries if what == "arm"]) == 3, "all are armed")
        launch.process.send_signal(number)
        assert launch.end() == 128 + number
    check_all_landed(sandbox, launch.folder, "stopped by SIGTERM")
    assert "take_off" not in {what for _, what in sandbox.entries}


def test_when_the_launcher_is_killed_all_bodies_land(sandbox: Sandbox, tmp_path: Path) -> None:
    with Launch(sandbox.file, tmp_path / "run", *WALL) as launch:
        launch.flying()
        launch.process.kill()
        launch.process.wait(10)
        until(lambda: not launch.daemons(), "all daemons have ended")
        check_all_landed(sandbox, launch.folder, "stopped by the launcher's end")


def test_agentd_land_lands_all_bodies(sandbox: Sandbox, tmp_path: Path) -> None:
    with Launch(sandbox.file, tmp_path / "run", *WALL) as launch:
        launch.flying()
        done = agentd("land", str(launch.folder))
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.splitlines() == [f"agent {agent}: lands" for agent in (1, 2, 3)]
        assert launch.end() == 1
        check_all_landed(sandbox, launch.folder, "landed by an operator")
        again = agentd("land", str(launch.folder))
        assert (again.returncode, again.stderr) == (2, f"agentd: {launch.folder}: this run is over\n")


def test_the_run_of_a_fleet_that_flies_is_found_although_a_newer_one_is_over(sandbox: Sandbox, tmp_path: Path) -> None:
    flown = tmp_path / "runs" / "old"
    with Launch(sandbox.file, flown, *WALL) as launch:
        launch.flying()
        name = str(launch.about["fleet"])
        newer = tmp_path / "runs" / "new"
        newer.mkdir()
        for file in ("operator.json", "run.json"):
            content = json.loads((flown / file).read_text())
            text = json.dumps({**content, "ended": "now"}).replace("/run/", "/new/").replace("/old", "/new")
            (newer / file).write_text(text)
        command = [sys.executable, "-m", "agentd", "land", name]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=30, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        assert launch.end() == 1


def test_a_flight_that_did_not_begin_leaves_logs_and_no_figures(sandbox: Sandbox, tmp_path: Path) -> None:
    fails = "agents.3.plants.body.fails='inspect'"
    done = agentd("launch", str(sandbox.file), "--clock", "wall", "--set", fails, "--out", str(tmp_path / "run"))
    assert done.returncode == 1
    assert done.stdout.endswith(f"\n{tmp_path}/run: log of every agent\n")


HANGS = """\
import numpy as np


def hang(problem, me):
    inbox = yield {"x": 0.0}, 1.0
    step = me.recall("step", 0)
    while step == 3 and me.id == 2:
        pass
    return me.result(problem.start(me.last), step=step + 1)
"""


def test_agentd_stop_reaches_a_body_whose_algorithm_hangs_although_the_files_of_the_run_are_damaged(
    sandbox: Sandbox, tmp_path: Path
) -> None:
    (tmp_path / "hang.py").write_text(HANGS)
    lonely = ["algorithm.kind='./hang.py:hang'", "safety.neighbour_silent.then='continue'"]
    with Launch(sandbox.file, tmp_path / "run", *WALL, *lonely) as launch:
        launch.flying()
        until(lambda: (log := launch.log(3)) is not None and len(log.step) > 8, "agent 2 hangs")
        file = launch.folder / "fleet.toml"
        file.write_text(file.read_text()[:200])
        (launch.folder / "run.json").write_text('{"endpoints": ')
        (launch.folder / "plugins" / "body.py").write_text("raise ImportError")
        done = agentd("stop", str(launch.folder))
        assert done.stdout.splitlines() == ["agent 1: motors off", "agent 3: motors off"]
        assert done.stderr == "agentd: agent 2 did not answer within 3 s\n"
        assert done.returncode == 1
        assert {agent for agent, what in sandbox.entries if what == "emergency"} == {1, 2, 3}
        assert launch.end() == 1
    for agent in (1, 3):
        assert sandbox.of(agent)[-3:] == ["emergency", "finish stopped", "close"]


def test_land_and_stop_import_neither_numpy_nor_what_reads_fleet_files() -> None:
    slow = ("numpy", "numba", "matplotlib", "pydantic", "rich", "dcf_zenoh.config", "dcf_zenoh.plugins", "plants")
    text = f"import sys, agentd.__main__, agentd.operator.land_stop; print([n for n in {slow} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=30, check=True)
    assert done.stdout == "[]\n"


def test_land_and_stop_send_the_bytes_of_the_protocol() -> None:
    assert operator_protocol.encode(operator_protocol.Land()) == end_requests.LAND
    assert end_requests.STOP == operator_protocol.HALT
    answer = operator_protocol.Answer(agent=1, time=5)
    assert end_requests.error_in(operator_protocol.encode(answer)) == ""
    refusal = operator_protocol.Answer(agent=1, error="no")
    assert end_requests.error_in(operator_protocol.encode(refusal)) == "no"
    assert end_requests.error_in(b"") == operator_protocol.decode_answer(b"", 1).error
    assert end_requests.error_in(b"\xc1").startswith("not an answer: ")
    assert end_requests.error_in(b"\x01").startswith("not an answer: ")


SLOW = """\
        self.stopped = True

    def act(self, setpoint, now):
        super().act(setpoint, now)
        for _ in range(15):  # the stop mostly comes during this loop
            time.sleep(0.01)
            if hasattr(self, "stopped"):
                raise RuntimeError("motors off")
"""


def test_agentd_stop_is_answered_even_by_an_agent_that_fails_because_of_it(sandbox: Sandbox, tmp_path: Path) -> None:
    body = "import time\n" + (tmp_path / "body.py").read_text()
    heard = 'self.note("emergency")\n'
    (tmp_path / "body.py").write_text(body.replace(heard, heard + SLOW))
    with Launch(sandbox.file, tmp_path / "run", *WALL, "safety.neighbour_silent.then='continue'") as launch:
        launch.flying()
        done = agentd("stop", str(launch.folder))
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.splitlines() == [f"agent {agent}: motors off" for agent in (1, 2, 3)]
        assert launch.end() == 1


def make_real(folder: Path) -> None:
    file = folder / "body.py"
    file.write_text(file.read_text().replace(REAL, f"{REAL}\n    real = True"))


def test_real_bodies_stay_on_the_ground_without_a_terminal(sandbox: Sandbox, tmp_path: Path) -> None:
    make_real(tmp_path)
    with Launch(sandbox.file, tmp_path / "run", *WALL) as launch:
        assert launch.end() == 2
    text = "real bodies take off when a person presses a key: there is no terminal; --yes agrees beforehand"
    assert launch.errors == f"agentd: {text}\n"
    assert not sandbox.diary.exists()


def test_real_bodies_take_off_at_once_with_consent_on_the_command_line(sandbox: Sandbox, tmp_path: Path) -> None:
    make_real(tmp_path)
    with Launch(sandbox.file, tmp_path / "run", "time.clock='wall'", "time.duration=1.0", yes=True) as launch:
        assert launch.end() == 0
    assert sandbox.of(1)[:6] == PHASES


def test_in_a_terminal_one_key_takes_off_and_one_lands(sandbox: Sandbox, tmp_path: Path) -> None:
    make_real(tmp_path)
    master, slave = os.openpty()
    words = [sys.executable, "-m", "agentd", "launch", str(sandbox.file), "--out", str(tmp_path / "run"), "--no-report"]
    process = subprocess.Popen(
        [*words, *(word for change in WALL for word in ("--set", change))],
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # noqa: PLW1509
    )
    os.close(slave)
    os.set_blocking(master, False)
    seen = bytearray()

    def shows(text: bytes) -> bool:
        with suppress(OSError):  # nothing to read, or the process has ended
            seen.extend(os.read(master, 65536))
        return text in seen

    try:
        until(lambda: shows(b"press t to take off"), "the launcher asks")
        assert b"agent 2 is ready: battery 3.92 V, heading 1 deg" in seen
        assert {what for _, what in sandbox.entries} == {"prepare", "inspect"}
        os.write(master, b"t")
        until(lambda: shows(b"t: take off") and sandbox.of(3)[-1].startswith("start"), "the fleet flies")
        os.write(master, b"L")
        until(lambda: shows(b"l: land") and process.poll() is not None, "the fleet has landed")
        assert process.returncode == 1
    finally:
        process.kill()
        process.wait(10)
        os.close(master)
    check_all_landed(sandbox, tmp_path / "run", "landed by its operator")
