"""Commands on run directories whose logs are damaged, exchanged, or those of another run."""

import re
from collections.abc import Callable
from pathlib import Path
from shutil import copytree

import pytest

from dcf_zenoh.records.log_writer import log_name, packed, read_stream
from tests.support.command_line import Answer
from tests.support.faulty_runs import named

Agentd = Callable[..., Answer]
COMMANDS = {
    "why": ["why", "{run}"],
    "links": ["links", "{run}"],
    "report": ["report", "{run}", "--out", "{out}"],
    "export": ["export", "{run}", "--to", "csv", "--out", "{out}.csv"],
    "diff": ["diff", "{run}", "{run}"],
    "show": ["fault", "{run}", "show"],
    "rules": ["fault", "{run}", "export"],
}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run directory of four agents, ten steps, with losses."""
    folder = tmp_path_factory.mktemp("flown")
    named(folder, "[faults]\nloss = 0.2\n", "exchange.max_rounds=8", out=folder / "run")
    return folder / "run"


@pytest.fixture
def told(agentd: Agentd, caplog: pytest.LogCaptureFixture) -> Agentd:
    """Run a command line in this process; warnings, which pytest holds back, stand in front of its errors."""

    def run(*words: str | Path) -> Answer:
        caplog.clear()
        answer = agentd(*words)
        return answer._replace(err="".join(f"{line}\n" for line in caplog.messages) + answer.err)

    return run


@pytest.fixture
def run(flown: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return copytree(flown, tmp_path / "run")


def words(command: str, run: Path) -> list[str]:
    return [word.format(run=run, out=run.parent / "out") for word in COMMANDS[command]]


def damage(path: Path) -> int:
    """Make the seventh object of a log, step 5, none; where that is."""
    data = path.read_bytes()
    ends = [end for _, end in read_stream(data)]
    path.write_bytes(data[: ends[5]] + b"\xdf" + data[ends[5] + 1 :])
    return ends[5]


def exchange(run: Path) -> None:
    one, two = run / log_name(1), run / log_name(2)
    first = one.read_bytes()
    one.write_bytes(two.read_bytes())
    two.write_bytes(first)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_damaged_log_is_told_in_one_line_and_read_up_to_there(command: str, run: Path, told: Agentd) -> None:
    at = damage(run / log_name(2))
    answer = told(*words(command, run))
    looks = command in ("show", "rules")
    assert answer.code == (1 if looks else 0)
    (said,) = {line for line in answer.err.splitlines() if "damaged after step 4 (byte" in line}
    size = (run / log_name(2)).stat().st_size
    assert f"{run / log_name(2)}: damaged after step 4 (byte {at} of {size}): " in said
    assert said.endswith("; what was changed later is not known" if looks else "; what follows is left out")
    if command in ("why", "links"):
        assert "agentd: note: agent 2's log is damaged after step 4" in answer.err.splitlines()


@pytest.mark.parametrize("command", COMMANDS)
def test_random_bytes_cost_one_agent(command: str, run: Path, told: Agentd) -> None:
    (run / log_name(2)).write_bytes(b"\x81\x81\xa1a\x01\x02")  # a map with a map as a key
    answer = told(*words(command, run))
    assert answer.code == (1 if command in ("show", "rules") else 0)
    said = [line for line in answer.err.splitlines() if str(run / log_name(2)) in line]
    assert len(set(said)) == 1
    assert f"{run / log_name(2)}: not a log of an agent: its header cannot be read: not msgpack: unhashable" in said[0]


@pytest.mark.parametrize("command", COMMANDS)
def test_exchanged_logs_are_refused(command: str, run: Path, told: Agentd) -> None:
    exchange(run)
    answer = told(*words(command, run))
    assert answer.code == (1 if command in ("show", "rules") else 0)
    whose = "fleet 'position_swap', seed 1"
    for agent, other in ((1, 2), (2, 1)):
        said = f"{run / log_name(agent)}: the log of agent {other}, {whose}; expected agent {agent}, {whose}"
        assert said in answer.err


def test_a_log_of_another_run_and_fleet_is_refused(run: Path, trio: Path, told: Agentd) -> None:
    other = run.parent / "other"
    short = ("--seed", "7", "--set", "time.duration=1.0", "--no-report", "--json")
    assert told("simulate", trio, *short, "--out", other).code == 0
    (run / log_name(3)).write_bytes((other / log_name(3)).read_bytes())
    answer = told("links", run)
    assert answer.code == 0
    owners = "agent 3, fleet 'trio', seed 7; expected agent 3, fleet 'position_swap', seed 1"
    assert answer.err.splitlines() == [
        f"{run / log_name(3)}: the log of {owners}",
        "agentd: note: agent 3 has no log that can be read",
    ]
    assert "→ 3" not in answer.out


def test_without_a_log_that_can_be_read_nothing_is_exported(run: Path, told: Agentd) -> None:
    for agent in (1, 2, 3, 4):
        (run / log_name(agent)).write_bytes(b"nothing")
    for command in ("export", "show"):
        answer = told("fault", run, command)
        assert answer.code == 1
        assert [line.partition(": ")[2] for line in answer.err.splitlines()] == [
            f"{run / log_name(agent)}: not a log of an agent: it has no header" for agent in (1, 2, 3, 4)
        ]
        assert (answer.out == "") == (command == "export")
    answer = told("why", run)
    assert (answer.code, answer.out) == (1, "")


def test_a_change_of_faults_that_is_none_costs_one_agent(run: Path, told: Agentd) -> None:
    path = run / log_name(2)
    items = [item for item, _ in read_stream(path.read_bytes())]
    items.insert(3, {"event": "fault", "time": 5, "change": {"do": "set", "senders": "all"}})
    path.write_bytes(b"".join(map(packed, items)))
    answer = told("fault", run, "export")
    assert (answer.code, answer.out) == (1, "")
    assert re.fullmatch(f"agentd: agent 2: its log in {run}: not a change of faults: .*\n", answer.err)


@pytest.mark.parametrize("command", ["why", "links", "report", "export", "diff"])
def test_where_nothing_is_it_says_so(command: str, tmp_path: Path, told: Agentd) -> None:
    said = f"agentd: {tmp_path / 'nope'}: there is no such directory; expected that of a run\n"
    assert told(*words(command, tmp_path / "nope")) == (1, "", said)


@pytest.mark.parametrize("text", ["[]", '{"endpoints": 3}', "{", "\0"])
def test_what_the_launcher_noted_can_be_damaged(text: str, run: Path, told: Agentd) -> None:
    (run / "run.json").write_text(text)
    answer = told("fault", run, "show")
    assert (answer.code, answer.out) == (1, "")
    assert answer.err.startswith(f"agentd: {run / 'run.json'}: cannot be read: ")
    assert len(answer.err.splitlines()) == 1


def test_a_damaged_log_is_not_continued(run: Path, told: Agentd) -> None:
    at = damage(run / log_name(2))
    before = (run / log_name(2)).read_bytes()
    fleet = run / "fleet.toml"
    fleet.write_text(fleet.read_text().replace('"virtual"', '"wall"'))
    answer = told("run", fleet, "--id", "2", "--out", run, "--rejoin")
    assert (answer.code, answer.out) == (1, "")
    assert answer.err.splitlines()[-1].startswith(
        f"agentd: --rejoin: {run / log_name(2)}: damaged after step 4 (byte {at} of "
    )
    assert answer.err.endswith("; it cannot be continued\n")
    assert (run / log_name(2)).read_bytes() == before
