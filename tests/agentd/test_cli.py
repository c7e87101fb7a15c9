"""Bad input on the command line: one line per problem, and an exit code."""

import re
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from agentd.cli import main
from dcf_zenoh.plugins import known
from tests.support.command_line import QUICK, Answer
from tests.support.daemons import TRIO

FRAIL = """
from plants.point_mass import PointMass
class Frail(PointMass):
    def __init__(self, start):
        raise ValueError("it broke")
"""


BAD_FLEETS = {
    "unknown key": (
        ["--set", "time.durration=1"],
        "time.durration: [time] has no key 'durration'; did you mean 'duration'? accepted: clock, sample_time,"
        " duration, arrived",
    ),
    "wrong type": (
        ["--set", "time.duration=long"],
        "time.duration: expected a number > 0 (length of the run, s), not 'long'",
    ),
    "negative duration": (
        ["--set", "time.duration=-1.0"],
        "time.duration: expected a number > 0 (length of the run, s), not -1.0",
    ),
    "no change": (
        ["--set", "nonsense"],
        "nonsense: expected key.path=value, such as time.duration=10.0",
    ),
    "missing agent": (
        ["--set", "topology.kind=edges", "--set", "topology.links=[[1, 2], [2, 9]]"],
        "topology: edges refused its options: TopologyError: links must be pairs of different agents among [1, 2, 3],"
        " not [2, 9]",
    ),
    "unconnected graph": (
        ["--set", "topology.kind=edges", "--set", "topology.links=[[1, 2]]"],
        "topology: the graph is not connected: nothing agent 1 sends can reach agent 3",
    ),
    "unknown algorithm": (
        ["--algorithm", "tradse"],
        "algorithm: there is no [algorithms.tradse] and no kind 'tradse'; did you mean 'trades'? tables: none;"
        f" known algorithms: {', '.join(sorted(known('algorithms')))}",
    ),
    "unknown plug-in": (
        ["--set", "plants.point.kind=point_mas"],
        "plants.point.kind: unknown kind 'point_mas'; did you mean 'point_mass'?"
        f" known plants: {', '.join(sorted(known('plants')))};"
        " or 'package.module:Name', './file.py:Name'",
    ),
    "value that a built-in plant refuses": (
        ["--set", "plants.point.accel_max=-1.0"],
        "plants.point: PointMass refused its options: accel_max must be positive, in m/s², not -1.0",
    ),
    "start in a safety region": (
        ["--set", "agents.2.start=[0.1, 0.9]"],
        "agents.2.start: agent 2 would start in the safety region of agent 1: h = -0.4, expected at least 0"
        " (they are 0.1 m apart in x and 0.1 m in y; radii 0.5 m and 0.25 m)",
    ),
    "unknown topology": (
        ["--topology", "rng"],
        "topology.kind: unknown kind 'rng'; did you mean 'ring'?"
        f" known topologies: {', '.join(sorted(known('topologies')))}; or 'package.module:Name', './file.py:Name'",
    ),
    "no such plug-in file": (
        ["--set", "algorithm.kind=./mine.py:mine"],
        "algorithm.kind: ./mine.py:mine: cannot read {folder}/mine.py: No such file or directory",
    ),
}


@pytest.mark.parametrize("case", BAD_FLEETS)
@pytest.mark.parametrize("command", ["simulate", "launch", "check", "run"])
def test_error_in_a_fleet_is_reported_in_one_line(
    command: str, case: str, trio: Path, agentd: Callable[..., Answer]
) -> None:
    words, expected = BAD_FLEETS[case]
    out = {"check": [], "run": ["--id", "1", "--out", trio.parent / "run"]}.get(
        command, ["--json", "--out", trio.parent / "run"]
    )
    answer = agentd(command, trio, *words, *out)
    assert answer == (2, "", f"agentd: {trio}: {expected.format(folder=trio.parent)}\n")
    assert not (trio.parent / "run").exists()


def test_all_problems_of_a_fleet_are_reported_at_once(trio: Path, agentd: Callable[..., Answer]) -> None:
    wrong = ["--set", "time.duration=-1.0", "--set", "sed=3", "--set", "agents.2.start=[1.0, 'far']"]
    answer = agentd("check", trio, *wrong)
    assert answer.code == 2
    assert answer.err.splitlines() == [
        f"agentd: {trio}: time.duration: expected a number > 0 (length of the run, s), not -1.0",
        f"agentd: {trio}: agents.2.start: expected a list of numbers (position before the first step, m),"
        " not [1.0, 'far']",
        f"agentd: {trio}: sed: a fleet file has no key 'sed'; did you mean 'seed'? accepted: name, seed, plant, arena,"
        " time, exchange, topology, problem,"
        " algorithm, algorithms, controller, plants, agents, faults, safety, log, zenoh",
    ]


BAD_FILES = {
    "not TOML": (b"name = trio\n", "not TOML: Invalid value (at line 1, column 8)"),
    "not text": (b"\xff\xfe", "not TOML, which is UTF-8: 'utf-8' codec can't decode byte 0xff in position 0"),
    "no agents": (TRIO[: TRIO.index("[agents.1]")].encode(), "agents: missing; expected a table"),
    "the same id again": (f"{TRIO}[agents.1]\n".encode(), "not TOML: Cannot declare ('agents', '1') twice (at line"),
    "the same id otherwise": (f"{TRIO}[agents.01]\n".encode(), "agents.01: the same agent as agents.1"),
    "an agent without a start": (f"{TRIO}[agents.4]\ntarget = [0.0, 0.0]\n".encode(), "agents.4.start: missing; plant"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_file_that_is_not_a_fleet_is_refused(case: str, trio: Path, agentd: Callable[..., Answer]) -> None:
    content, expected = BAD_FILES[case]
    trio.write_bytes(content)
    answer = agentd("simulate", trio, "--json", "--out", trio.parent / "run")
    assert answer.code == 2
    assert answer.out == ""
    assert answer.err.startswith(f"agentd: {trio}: {expected}")
    assert all(line.startswith(f"agentd: {trio}: ") for line in answer.err.splitlines())


def test_missing_file_and_unknown_name_are_distinguished(agentd: Callable[..., Answer]) -> None:
    assert agentd("check", "nowhere/trio.toml") == (2, "", "agentd: nowhere/trio.toml: there is no such file\n")
    answer = agentd("check", "positon_swap")
    assert answer.code == 2
    assert re.fullmatch(
        "agentd: positon_swap: no file and no built-in fleet of this name; did you mean 'position_swap'\\?"
        " built in: .*position_swap.*\n",
        answer.err,
    )


def test_id_that_is_not_in_the_fleet_is_refused(trio: Path, agentd: Callable[..., Answer]) -> None:
    expected = f"agentd: {trio}: --id 7: there is no such agent; agents are [1, 2, 3]\n"
    assert agentd("run", trio, "--id", "7", "--out", trio.parent / "run") == (2, "", expected)
    assert not (trio.parent / "run").exists()


def test_plug_in_that_refuses_its_options_is_named(trio: Path, agentd: Callable[..., Answer]) -> None:
    (trio.parent / "frail.py").write_text(FRAIL)
    expected = "plant: Frail refused its options: it broke"
    wrong = ["--plant", f"{trio.parent}/frail.py:Frail"]
    assert agentd("simulate", trio, *QUICK, *wrong, "--out", trio.parent / "a") == (
        2, "", f"agentd: agents.1: {expected}\n",
    )  # fmt: skip
    answer = agentd("launch", trio, *QUICK, *wrong, "--out", trio.parent / "b")
    assert answer.code == 1
    assert answer.out == ""
    assert re.search(
        r"agentd: agent (\d) ended with exit code 2 \d+\.\d s after the launch, before its first step: agents\.\1: "
        + re.escape(expected),
        answer.err,
    )
    assert "Traceback" not in answer.err


def test_port_in_use_is_reported(trio: Path, agentd: Callable[..., Answer]) -> None:
    with socket.socket() as owner:
        owner.bind(("127.0.0.1", 0))
        owner.listen()
        endpoint = f"tcp/127.0.0.1:{owner.getsockname()[1]}"
        wrong = ["--set", f"agents.1.endpoint={endpoint}"]
        expected = f"agent 1: cannot listen on {endpoint}, or cannot connect to []: "
        answer = agentd("run", trio, *wrong, "--id", "1", "--out", trio.parent / "a")
        assert (answer.code, answer.out) == (1, "")
        assert answer.err.startswith(f"agentd: {expected}")
        assert answer.err.count("\n") == 1
        answer = agentd("launch", trio, *QUICK, *wrong, "--out", trio.parent / "b")
        assert (answer.code, answer.err) == (
            1,
            f"agentd: agents.1.endpoint: cannot listen on {endpoint}: Address already in use\n",
        )


@pytest.mark.parametrize("command", ["simulate", "launch", "run"])
def test_run_directory_that_cannot_be_written_is_reported(
    command: str, trio: Path, agentd: Callable[..., Answer]
) -> None:
    folder = trio / "run"
    words = ["--id", "1"] if command == "run" else ["--json"]
    assert agentd(command, trio, *words, "--out", folder) == (
        1, "", f"agentd: {folder}: cannot be written: Not a directory\n",
    )  # fmt: skip


def test_run_directory_that_is_not_empty_is_refused(flown: Path, trio: Path, agentd: Callable[..., Answer]) -> None:
    for command in ("simulate", "launch"):
        expected = f"agentd: {flown}: this directory is not empty; choose another with --out\n"
        assert agentd(command, trio, *QUICK, "--out", flown) == (1, "", expected)
    before = (flown / "fleet.toml").read_bytes()
    answer = agentd("run", trio, "--id", "1", "--out", flown)
    expected = f"agentd: {flown / 'agent-1.msgpack'}: there is a log already; choose another directory with --out\n"
    assert (answer.code, answer.err) == (1, expected)
    assert (flown / "fleet.toml").read_bytes() == before


@pytest.mark.parametrize("words", [["report"], ["rerun"], ["export", "--to", "csv"], ["diff", "{flown}"]])
def test_directory_that_is_not_a_run_is_refused(
    words: list[str], flown: Path, tmp_path: Path, agentd: Callable[..., Answer]
) -> None:
    expected = f"agentd: {tmp_path}: not a run directory: it has no fleet.toml\n"
    assert agentd(*(word.format(flown=flown) for word in words), tmp_path) == (1, "", expected)


def test_run_without_logs_is_refused(flown: Path, tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    (tmp_path / "fleet.toml").write_bytes((flown / "fleet.toml").read_bytes())
    (tmp_path / "agent-1.msgpack").touch()
    expected = f"agentd: {tmp_path}: not one log of agents [1, 2, 3]; expected files like agent-1.msgpack\n"
    assert agentd("report", tmp_path) == (1, "", expected)


def test_unknown_export_format_is_refused(flown: Path, agentd: Callable[..., Answer]) -> None:
    answer = agentd("export", flown, "--to", "xls")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.count("\n") == 1
    assert "csv" in answer.err


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "agentd: error: the following arguments are required: COMMAND"),
        (["simulate"], "agentd simulate: error: the following arguments are required: FLEET"),
        (["simulate", "x", "--clock", "sundial"], "invalid choice: 'sundial' (choose from 'wall', 'virtual')"),
        (["plugins", "plans"], "invalid choice: 'plans'"),
        (["launch", "x", "--seed", "one"], "argument --seed: invalid int value: 'one'"),
    ],
)
def test_command_line_that_cannot_be_parsed_is_refused(
    words: list[str], expected: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2
    assert expected in capfd.readouterr().err
