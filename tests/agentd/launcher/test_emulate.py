"""``agentd emulate-crazyflie`` as a process: start, commands on standard input, end."""

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, cast

import pytest

from agentd import exit_codes
from agentd.cli import main
from plants.crazyflie.emulator.truth import read_truth

pytestmark = pytest.mark.real_time

FLEET = """
name = "flock"
plant = "hardware"

[problem]
kind = "position_swap"

[algorithm]
kind = "trades"

[plants.hardware]
kind = "./flock.py:Flock"

[plants.point]
kind = "point_mass"

[agents.3]
start = [0.5, 1.0]
target = [0.0, -1.0]
plants.hardware = { uri = "udp://127.0.0.1:PORT" }

[agents.7]
start = [0.0, -1.0]
target = [0.0, 1.0]
plant = "point"
"""
PLANT = """
from plants.point_mass import PointMass


class Flock(PointMass):
    def __init__(self, start, *, uri: str) -> None:
        super().__init__(start)
"""


@contextmanager
def emulating(*options: str) -> Iterator["subprocess.Popen[str]"]:
    """Run the command as a process with pipes; kill it at the end."""
    command = [sys.executable, "-m", "agentd", "emulate-crazyflie", *options]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def ready(process: "subprocess.Popen[str]", count: int) -> dict[int, str]:
    """Wait until `count` drones are ready; return number -> URI."""
    lines = [line(process).split() for _ in range(count)]
    assert all(word == "ready" for word, *_ in lines), lines
    return {int(number): uri for _, number, uri in lines}


def line(process: "subprocess.Popen[str]") -> str:
    return cast(IO[str], process.stdout).readline().strip()


def command(process: "subprocess.Popen[str]", text: str) -> str:
    """Send a command; return the answer."""
    stdin = cast(IO[str], process.stdin)
    stdin.write(text + "\n")
    stdin.flush()
    return line(process)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def test_drones_stand_on_a_cross_and_obey_by_number_or_all(tmp_path: Path) -> None:
    with emulating("--n", "5", "--port", "0", "--truth", str(tmp_path)) as process:
        uris = ready(process, 5)
        assert len(set(uris.values())) == 5
        places = [json.loads(command(process, f"{i} state"))["position"][:2] for i in uris]
        assert places == [[0.0, 1.0], [0.0, -1.0], [1.0, 0.0], [-1.0, 0.0], [2.0, 0.0]]
        assert command(process, "all battery 3.5") == "ok all battery 3.5"
        assert json.loads(command(process, "2 state"))["battery"] == pytest.approx(3.5, abs=0.01)
        assert command(process, "2 place 0.5 0.6") == "ok 2 place 0.5 0.6"
        assert json.loads(command(process, "2 state"))["position"] == [0.5, 0.6, 0.0]
        assert command(process, "6 state") == "error: there is no drone 6; there are 1, 2, 3, 4, 5"
        assert command(process, "1 silence long").startswith("error: expected DRONE silence SECONDS, not")
        assert command(process, "nonsense").startswith("error: expected DRONE battery|silence|kill-link|")
        assert command(process, "quit") == ""
        assert process.wait(10) == 0
    assert read_truth(tmp_path / "drone-5.jsonl")[0]["event"] == "checks passed"


def test_unknown_command_is_answered_and_has_no_effect() -> None:
    lines = {
        "tumble yes": "tumble [on|off]",
        "refuse-arm maybe": "refuse-arm [on|off]",
        "freeze-estimate 1": "freeze-estimate [on|off]",
        "battery nan": "battery VOLTS",
        "battery -1": "battery VOLTS",
        "silence -1": "silence SECONDS",
        "loss 2": "loss PROBABILITY (0 to 1)",
        "drift inf 0": "drift VX VY",
        "place nan 0": "place X Y [YAW_DEGREES]",
        "base-stations 99999999999": "base-stations NUMBER (0 to 16)",
        "base-stations some": "base-stations NUMBER (0 to 16)",
        "variance -1": "variance SQUARE_METRES|off",
    }
    with emulating("--n", "1", "--port", "0") as process:
        ready(process, 1)
        for words, usage in lines.items():
            assert command(process, f"1 {words}") == f"error: expected DRONE {usage}, not '1 {words}'"
        assert json.loads(command(process, "1 state"))["position"] == [0.0, 1.0, 0.0]
        assert command(process, "1 tumble on") == "ok 1 tumble on"


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGINT])
def test_signals_end_it_cleanly(end: signal.Signals) -> None:
    with emulating("--n", "1", "--port", "0") as process:
        ready(process, 1)
        process.send_signal(end)
        assert process.wait(10) == 0
        assert cast(IO[str], process.stderr).read() == ""


@pytest.mark.parametrize("supervised", [True, False])
def test_end_of_standard_input_ends_it_only_if_asked_to(supervised: bool) -> None:
    with emulating("--n", "1", "--port", "0", *["--until-stdin-closes"] * supervised) as process:
        ready(process, 1)
        cast(IO[str], process.stdin).close()
        if supervised:
            assert process.wait(10) == 0
        else:
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(1.0)
            process.terminate()
            assert process.wait(10) == 0


def test_agents_of_a_fleet_with_such_uris_are_emulated_where_they_start(tmp_path: Path) -> None:
    port = free_port()
    (tmp_path / "flock.toml").write_text(FLEET.replace("PORT", str(port)))
    (tmp_path / "flock.py").write_text(PLANT)
    with emulating("--fleet", str(tmp_path / "flock.toml")) as process:
        assert ready(process, 1) == {3: f"udp://127.0.0.1:{port}"}
        assert json.loads(command(process, "3 state"))["position"] == [0.5, 1.0, 0.0]


def test_bad_input_is_reported_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        for options, expected in (
            (["--n", "1", "--port", str(port)], f"udp://127.0.0.1:{port}: Address already in use"),
            (["--n", "1", "--port", "0", "--parameters", "cf9"], "unknown parameters 'cf9'; known: cf2x_p250, forster"),
            (["--n", "0"], "expected --n from 1 to 100"),
            (["--loss", "1.5"], "expected --loss from 0 to 1"),
            (["--latency", "-1"], "expected --latency"),
            (["--fleet", "position_swap", "--plant", "point"], "no agent has a plant with a uri of udp:// or tcp://"),
        ):
            assert main(["emulate-crazyflie", *options]) == exit_codes.MISUSED
            error = capsys.readouterr().err
            assert error.startswith("agentd: ")
            assert error.count("\n") == 1
            assert expected in error
