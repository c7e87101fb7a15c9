"""``agentd fault``, with a fleet of real daemons that an operator changes while it runs."""

import io
import os
import re
import shutil
import signal
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from agentd.cli import main
from agentd.daemon.operator_protocol import decode_answer
from agentd.operator.fault_history import changes_of
from agentd.operator.running_fleet import RunningFleet
from agentd.operator.session import send_queries
from agentd.run_directory import read_run_json, write_run_json
from dcf_zenoh import Run
from dcf_zenoh.config import freeze, load
from dcf_zenoh.configuration.building.fault_links import window_of
from dcf_zenoh.records.log_writer import packed, read_stream
from dcf_zenoh.rounds.receiver import Passed
from tests.support.command_line import Answer
from tests.support.daemons import PROCESSES, Launch
from tests.support.small_fleet import small_fleet
from tests.support.waiting import until

pytestmark = [pytest.mark.real_time, pytest.mark.whole_fleet]

PLUGINS = """\
import numpy as np
from dcf_zenoh.plant import Setpoint


class Hover:
    def at(self, states):
        return self

    def setpoint(self, decision, stage):
        return Setpoint(acceleration=decision)


def talk(problem, me):
    for _ in range(2):
        inbox = yield {"x": np.zeros(2)}, 1.0
        if inbox.stop:
            break
    return me.result(np.zeros(2))
"""
FLEET = small_fleet(
    "talk",
    plant=None,
    time={"clock": "wall", "duration": 300.0},
    exchange={"round_timeout": 0.03},
    safety={"neighbour_silent": {"then": "continue"}},
    problem={"kind": "./talk.py:Hover"},
    algorithm={"kind": "./talk.py:talk"},
    controller={"kind": "receding_horizon", "sharing": "piggyback"},
    plants={"point_mass": {}},
    agents={"1": {"start": [0.0, 0.0]}, "2": {"start": [1.0, 0.0]}, "3": {"start": [2.0, 0.0]}},
)
FLEET += "[[faults.rule]]\nfrom = 3\nto = 2\nduplication = 0.0\n"
IDS = (1, 2, 3)
NOWHERE = "tcp/127.0.0.1:9"  # no process listens there


@dataclass
class Flight:
    """Record of a flight during which an operator sends commands.

    Attributes:
        folder: Run directory.
        fleet: Fleet file.
        answers: Key -> answer of a command.
        malformed: Answer of agent 2 to bytes that are not a request.
    """

    folder: Path
    fleet: Path
    answers: dict[str, Answer] = field(default_factory=dict)
    malformed: str = ""

    @property
    def run(self) -> Run:
        return Run.read(self.folder)

    def events(self, agent: int) -> list[int]:
        """Return when faults on the links to an agent were changed, ns."""
        return [event["time"] for event in self.run.agents[agent].events if event["event"] == "fault"]

    def passed(self, sender: int, receiver: int) -> list[Passed]:
        return [each for each in self.run.agents[receiver].passed if each.sender == sender]


def write_fleet(folder: Path, text: str = FLEET) -> Path:
    (folder / "talk.py").write_text(PLUGINS)
    (folder / "talk.toml").write_text(text)
    return folder / "talk.toml"


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """Fly a fleet of three, change its faults in many ways, and stop it."""
    if not (PROCESSES / "self").exists():
        pytest.skip("processes are found in /proc")
    folder = tmp_path_factory.mktemp("flight")
    flight = Flight(folder / "run", write_fleet(folder))
    with pytest.MonkeyPatch.context() as patch, Launch(flight.fleet, flight.folder) as launch:
        patch.setattr("agentd.operator.query.TIMEOUT", 10.0)
        pids = launch.flying()

        def operate(key: str, *words: str) -> None:
            """Send a command of an operator, and wait for three steps."""
            flight.answers[key] = operated("fault", flight.folder, *words)
            now = {i: len(log.step) for i in IDS if (log := launch.log(i))}
            until(lambda: all((log := launch.log(i)) and len(log.step) >= now[i] + 3 for i in IDS), "three more steps")

        operate("loss", "--from", "1", "--to", "2", "loss", "1.0")
        operate("show", "show", "--to", "2")
        operate("end", "--from", "1", "--to", "2", "clear")
        operate("latency", "--from", "2", "latency", "mean=0.01", "reorder=false")
        operate("off", "--from", "3", "--to", "2", "duplication", "off")
        where = RunningFleet.read(flight.folder).address
        found = send_queries(where.prefix, where.entries(), {2: b"\x80\x04malformed"}, 10.0)
        flight.malformed = decode_answer(found[2], 2).error
        os.kill(pids[3], signal.SIGSTOP)
        patch.setattr("agentd.operator.query.TIMEOUT", 1.0)
        frozen = operated("fault", flight.folder, "--from", "2", "noise", "0.1")
        os.kill(pids[3], signal.SIGCONT)
        patch.setattr("agentd.operator.query.TIMEOUT", 10.0)
        flight.answers["frozen"] = frozen
        operate("clear", "clear")
        operate("bursts", "--to", "1", "bursts", "mean_loss=0.5", "mean_length=2")
        operate("export", "export")
        launch.process.send_signal(signal.SIGINT)
        launch.end()
    return flight


def operated(*words: str | Path) -> Answer:
    """Run a command line in this process."""
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        code = main([str(word) for word in words])
    return Answer(code, out.getvalue(), err.getvalue())


@pytest.fixture
def grounded(tmp_path: Path) -> Path:
    """The directory of a run on the wall clock whose agents cannot be reached."""
    return ground(tmp_path, FLEET)


def ground(folder: Path, text: str, name: str = "run") -> Path:
    freeze(load(write_fleet(folder, text)), folder / name)
    write_run_json(folder / name, {"fleet": "talk", "run": name, "endpoints": dict.fromkeys(IDS, NOWHERE)})
    return folder / name


def test_change_is_printed_with_its_links_and_its_time(flight: Flight) -> None:
    begin, end = (f"{time * 1e-9:.3f}" for time in flight.events(2)[:2])
    assert flight.answers["loss"] == (0, f"1 -> 2: loss = {{ probability = 1.0 }}, from {begin} s on\n", "")
    assert flight.answers["end"] == (0, f"1 -> 2: as in the fleet file again, from {end} s on\n", "")
    assert re.fullmatch(
        r"2 -> 1: latency = .*, from \d+\.\d{3} s on\n2 -> 3: latency = .*\n", flight.answers["latency"].out
    )


def test_loss_is_there_from_the_logged_time_until_it_is_cleared(flight: Flight) -> None:
    begin, end = flight.events(2)[:2]
    passed = flight.passed(1, 2)
    inside = [each.lost_by for each in passed if begin <= each.entered < end]
    assert len(inside) >= 4
    assert set(inside) == {"loss"}
    outside = [each.entered for each in passed if not begin <= each.entered < end]
    assert outside[0] < begin
    assert outside[-1] > end
    assert sum(bool(each.lost_by) for each in passed) == len(inside)


def test_nothing_is_lost_on_other_links(flight: Flight) -> None:
    bursts = flight.events(1)[-1]
    for receiver in IDS:
        for sender in set(IDS) - {receiver}:
            names = {each.lost_by for each in flight.passed(sender, receiver) if each.entered < bursts}
            assert names == ({"", "loss"} if (sender, receiver) == (1, 2) else {""})


def test_latency_is_there_from_the_logged_time(flight: Flight) -> None:
    for receiver in (1, 3):
        begin, *_, end = flight.events(receiver)[: 3 if receiver == 1 else 2]
        late = [each.due - each.entered for each in flight.passed(2, receiver) if begin <= each.entered < end]
        assert len(late) >= 4
        assert min(late) >= 10_000_000
        others = flight.passed(2, receiver)
        assert min(each.due - each.entered for each in others if each.entered < begin) < 10_000_000


def test_show_prints_what_acts_now_and_where_it_comes_from(flight: Flight) -> None:
    begin, end = flight.events(2)[:2]
    lines = flight.answers["show"].out.splitlines()
    assert re.fullmatch(rf"{re.escape(str(flight.folder))}, at \d+\.\d{{3}} s", lines[0])
    assert [re.split(r"  +", line) for line in lines[1:]] == [
        ["link", "fault", "acts now", "fleet file", "changed while running"],
        ["1 -> 2", "loss", "probability = 1.0", "-", f"probability = 1.0 from {begin * 1e-9:.3f} s"],
        ["3 -> 2", "duplication", *["probability = 0.0, delay = 0.0"] * 2, "-"],
    ]
    after = operated("fault", flight.folder, "show", "--from", "1,3", "--to", "2").out.splitlines()
    assert after[0].startswith(f"{flight.folder}, which is over, at ")
    assert after[2].startswith("1 -> 2  loss         -")
    assert after[2].endswith(f"probability = 1.0 from {begin * 1e-9:.3f} s to {end * 1e-9:.3f} s")
    assert re.search(r"off from \d+\.\d{3} s to \d+\.\d{3} s$", after[3])


def test_export_during_and_after_the_run_is_the_same(flight: Flight) -> None:
    after = operated("fault", flight.folder, "export")
    assert (after.code, after.err) == (0, "")
    assert after.out == flight.answers["export"].out


def test_exported_rules_make_the_same_windows_in_the_fleet_file(flight: Flight) -> None:
    flight.fleet.write_text(FLEET + operated("fault", flight.folder, "export").out)
    rules = load(flight.fleet).spec.faults.rule[1:]
    told = {(rule.from_, rule.to, *rule.faults): window_of(rule) for rule in rules}
    assert len(told) == len(rules)
    one, two, three = (flight.events(i) for i in IDS)
    never = 300_000_000_000
    assert told == {
        (1, 2, "loss"): (two[0], two[1]),
        (2, 1, "latency"): (one[0], one[2]),
        (2, 3, "latency"): (three[0], three[1]),
        (3, 2, "duplication"): (two[2], two[3]),
        (2, 1, "noise"): (one[1], one[2]),
        ((2, 3), 1, "bursts"): (one[3], never),
    }
    assert next(rule for rule in rules if "duplication" in rule.faults).faults == {"duplication": False}


def test_what_was_changed_is_read_from_the_logs_as_rules(flight: Flight) -> None:
    never = 300.0
    one, two, three = ([time * 1e-9 for time in flight.events(i)] for i in IDS)
    found = [
        (
            rule.from_,
            rule.to,
            *map(pytest.approx, rule.during),
            {name: fault and fault.kind for name, fault in rule.faults.items()},
        )
        for rule in changes_of(flight.run)
        if rule.during
    ]
    assert found == sorted(
        [
            (1, 2, two[0], two[1], {"loss": "loss"}),
            (2, 1, one[0], one[2], {"latency": "latency"}),
            (2, 3, three[0], three[1], {"latency": "latency"}),
            (3, 2, two[2], two[3], {"duplication": False}),
            (2, 1, one[1], one[2], {"noise": "noise"}),
            ((2, 3), 1, one[3], never, {"bursts": "bursts"}),
        ],
        key=lambda rule: rule[2],
    )


def test_frozen_agent_is_named_and_does_not_hold_up_the_others(flight: Flight) -> None:
    code, out, err = flight.answers["frozen"]
    assert code == 1
    assert re.fullmatch(r"2 -> 1: noise = \{ std = 0\.1 \}, from \d+\.\d{3} s on\n", out)
    assert err.splitlines()[0] == "agentd: agent 3 did not answer within 1 s"
    assert flight.answers["clear"].code == 0  # agent 3 runs again


def test_malformed_request_gets_an_error_and_has_no_effect(flight: Flight) -> None:
    assert flight.malformed.startswith("not a request: ")
    assert len(flight.events(2)) == 4
    assert {log.end and log.end["end"] for log in flight.run.agents.values()} == {"stopped"}


BAD = {
    "los 0.3": "los: unknown fault 'los'; did you mean 'loss'? known faults: ",
    "during 0.3": "unknown fault 'during'; ",
    "loss 3.0": "loss.probability: must be a probability, from 0 to 1, not 3.0",
    "loss probabilty=0.3": "loss.probabilty: Loss has no key 'probabilty'; did you mean 'probability'? accepted:",
    "loss": "loss.probability: missing; Loss needs a number",
    "loss much": "loss.probability: expected a number, not 'much'",
    "loss 0.1 0.2": "expected one value, or key=value for each key, such as mean=0.03 std=0.01; not '0.1 0.2'",
    "loss 0.1 probability=0.2": "loss.value: given twice: also as loss.probability",
    "latency mean=1 mean=2": "expected one value, or key=value for each key",
    "latency mean=0.1 distribution=normal": "latency.std: is missing: distribution 'normal' takes mean and std",
    "latency distribution=empirical file=none.json": "latency.file: there is no file ",
    "partition [[1,2],[3,9]]": "partition.groups: there is no agent 9; agents are 1, 2, 3",
    "range 1.5": "range: needs the positions of the agents, which messages carry only if the fleet file has it too",
    "mine kind=./talk.py:Hover": "mine.kind: ",
    "mine kind=./elsewhere.py:Mine": "mine.kind: expected a kind that is installed or that the fleet file names",
    "--from 9 loss 0.1": "--from: there is no agent 9; agents are 1, 2, 3",
    "--from 1 --to 1 loss 0.1": "--to: expected another agent than 1, as from; none has a link to itself",
    "--from one loss 0.1": "--from: expected ids of agents with commas, such as 1 or 1,2, not 'one'",
    "--to 1,,2 loss 0.1": "--to: expected ids of agents with commas, such as 1 or 1,2, not '1,,2'",
    "--to 9 clear": "--to: there is no agent 9; agents are 1, 2, 3",
    "clear loss": "clear: expected nothing more, not 'loss'",
    "show --from 9": "--from: there is no agent 9; agents are 1, 2, 3",
}


@pytest.mark.parametrize("words", BAD)
def test_bad_words_are_refused_before_anything_is_sent(
    words: str, grounded: Path, agentd: Callable[..., Answer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("agentd.operator.change_faults.query_agents")
    code, out, err = agentd("fault", grounded, *words.split())
    assert (code, out) == (2, "")
    assert err.startswith(f"agentd: {BAD[words]}")
    assert "faults.rule" not in err


def test_link_must_be_in_the_topology(tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    run = ground(tmp_path, FLEET + '[topology]\nkind = "path"\n')
    assert agentd("fault", run, "--from", "1", "--to", "3", "loss", "0.1").err == (
        "agentd: no link from 1 to 3 in topology 'path'; links there are: 1 -> 2, 2 -> 3\n"
    )


def test_loss_is_refused_where_rounds_have_no_time_out(tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    run = ground(tmp_path, FLEET.replace("round_timeout = 0.03", ""))
    code, _, err = agentd("fault", run, "loss", "0.1")
    assert code == 2
    assert err.startswith("agentd: exchange.round_timeout: missing; loss can lose messages, and a round would wait for")


def test_note_warns_of_a_cut_that_ends_the_run(
    tmp_path: Path, agentd: Callable[..., Answer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agentd.operator.query.TIMEOUT", 0.1)
    run = ground(tmp_path, FLEET.replace('"continue"', '"land"'))
    assert agentd("fault", run, "partition", "[[1], [2, 3]]").err.startswith(
        "agentd: note: partition: the run ends when a link is cut for more than 0.6 s, by safety.neighbour_silent"
    )


def test_agents_that_cannot_be_reached_are_all_named(
    grounded: Path, agentd: Callable[..., Answer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agentd.operator.query.TIMEOUT", 0.3)
    for words in (["loss", "0.1"], ["clear"], ["show"], ["export"]):
        code, out, err = agentd("fault", grounded, *words)
        assert code == 1
        assert " -> " not in out
        assert err.splitlines()[:3] == [f"agentd: agent {i} did not answer within 0.3 s" for i in IDS]


def test_run_in_virtual_time_cannot_be_changed(tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    fleet = write_fleet(tmp_path)
    run = tmp_path / "run"
    assert agentd("simulate", fleet, "--set", "time.duration=1.0", "--no-report", "--json", "--out", run).code == 0
    code, _, err = agentd("fault", run, "loss", "0.1")
    assert code == 2
    assert err == (
        f"agentd: {run}: a run in virtual time depends on its fleet file alone and cannot be changed from outside:"
        " put it into the fleet file, as a [[faults.rule]] with from, to and during\n"
    )
    assert agentd("fault", run, "export") == (0, "# nothing was changed\n", "")
    assert agentd("fault", run, "show", "--from", "3").out.splitlines()[2:] == [
        "3 -> 1  -            -                               -                               -",
        "3 -> 2  duplication  probability = 0.0, delay = 0.0  probability = 0.0, delay = 0.0  -",
    ]


def test_run_that_is_over_cannot_be_changed(flight: Flight) -> None:
    expected = f"agentd: {flight.folder}: this run is over; its log can still be looked at: show, export\n"
    assert operated("fault", flight.folder, "loss", "0.1") == (2, "", expected)
    assert operated("fault", flight.folder, "clear") == (2, "", expected)


def test_run_is_found_by_the_name_of_its_fleet(
    tmp_path: Path, agentd: Callable[..., Answer], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agentd.operator.query.TIMEOUT", 0.1)
    monkeypatch.chdir(tmp_path)
    for age, name in enumerate(["runs/new", "runs/old", "runs/older"]):
        ground(tmp_path, FLEET, name)
        os.utime(tmp_path / name / "fleet.toml", (1e9 - age, 1e9 - age))
    assert agentd("fault", "talk", "loss", "0.1").err.startswith(
        "agentd: note: the run is runs/new\nagentd: agent 1 did"
    )
    code, _, err = agentd("fault", "tlak", "loss", "0.1")
    assert code == 1
    assert err == (
        "agentd: tlak: no run directory, and no run of a fleet of this name below runs/; did you mean 'talk'?"
        " fleets that have run there: talk\n"
    )
    assert agentd("fault", "runs", "loss", "0.1") == (
        1, "", "agentd: runs: not a run directory: it has no fleet.toml\n"
    )  # fmt: skip


def test_rules_of_the_file_that_would_be_overruled_are_named(
    tmp_path: Path, agentd: Callable[..., Answer], flight: Flight
) -> None:
    folder = ground(tmp_path, FLEET + "[[faults.rule]]\nto = 2\nfrom = 1\nduring = [0.0, 1e-9]\nloss = 0.1\n")
    for agent in IDS:
        (folder / f"agent-{agent}.msgpack").write_bytes((flight.folder / f"agent-{agent}.msgpack").read_bytes())
    stream = folder / "agent-2.msgpack"
    items = [item for item, _ in read_stream(stream.read_bytes())]
    first = next(item for item in items if isinstance(item, dict) and item.get("event") == "fault")
    first["time"] = 0
    stream.write_bytes(b"".join(map(packed, items)))
    write_run_json(folder, {**read_run_json(folder), "ended": "just now"})
    code, _, err = agentd("fault", folder, "export")
    assert code == 0
    assert err.startswith(
        "agentd: note: with these rules at the end of the fleet file: faults.rule.2.loss: never acts, as faults.rule.3"
    )


def test_run_is_not_over_while_an_agent_that_was_started_again_flies(tmp_path: Path, flight: Flight) -> None:
    folder = tmp_path / "run"
    shutil.copytree(flight.folder, folder)
    assert RunningFleet.read(folder).over
    stream = folder / "agent-2.msgpack"
    header, *_ = (item for item, _ in read_stream(stream.read_bytes()))
    stream.write_bytes(stream.read_bytes() + packed({**header, "incarnation": 1}))
    assert not RunningFleet.read(folder).over
