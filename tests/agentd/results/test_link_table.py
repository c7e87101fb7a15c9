import json
from collections.abc import Callable
from pathlib import Path

import pytest

from dcf_zenoh import simulate
from dcf_zenoh.analysis.link_health import link_health
from dcf_zenoh.config import load
from dcf_zenoh.faults.profile import read_profile
from dcf_zenoh.records.run import Run
from tests.support.command_line import Answer
from tests.support.daemons import TRIO, Launch
from tests.support.faulty_runs import named
from tests.support.lossy_fleets import lossy

ONE = """
[[faults.rule]]
from = 1
to = 2
odd = { kind = "./named.py:Named", lost = [[3, 2], [5, 0], [5, 1]], doubled = [[4, 1]], delayed = [[6, 3]], by = 0.001 }
"""

LOSSY_ROUNDS = """
[exchange]
max_rounds = 10
round_timeout = 0.01

[safety]
neighbour_silent = { after = 9.0, then = "continue" }

"""


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory of a run in which the link from 1 to 2 has lost three messages."""
    folder = tmp_path_factory.mktemp("one")
    named(folder, ONE, out=folder / "run")
    return folder / "run"


def row(text: str, link: str) -> str:
    (found,) = (line for line in text.splitlines() if line.strip().startswith(link))
    return " ".join(found.split())


def test_a_link_is_a_row_with_what_was_lost_by_what(one: Path, agentd: Callable[..., Answer]) -> None:
    answer = agentd("links", one)
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.splitlines()[0].rstrip() == "position_swap, run: 12 links, virtual clock"
    found = row(answer.out, "1 → 2")
    assert "odd 3 1.50" in found
    assert found.split()[-2] == "1.00"  # ms, the latency of one message
    assert "Without faults, and therefore only counted: 1 → 3" in answer.out
    assert len(row(answer.out, "1 → 3").split()) < len(found.split())


def test_programs_get_one_object_with_times_in_seconds(one: Path, agentd: Callable[..., Answer]) -> None:
    answer = agentd("links", one, "--json")
    assert answer.out.count("\n") == 1
    found = json.loads(answer.out)
    assert (found["fleet"], found["run"], found["clock"]) == ("position_swap", "run", "virtual")
    link = found["links"][0]
    assert (link["from"], link["to"], link["lost"], link["duplicates"]) == (1, 2, 3, 1)
    assert link["lost_by"] == {"odd": 3}
    assert link["latency"]["max"] == 0.001
    assert found["links"][1]["latency"]["median"] is None
    assert found["links"][1]["longest_gap"] is None


def test_an_export_is_a_profile_and_lines_that_a_fleet_file_can_end_with(
    one: Path, agentd: Callable[..., Answer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = agentd("links", one, "--export", "lab.json")
    assert answer.code == 0
    assert "lab.json: profile of 1 of 12 links" in answer.err
    (profile,) = read_profile(tmp_path / "lab.json")
    assert (profile.sender, profile.receiver, profile.lost) == (1, 2, 3)
    fleet = load(lossy(tmp_path, answer.out))
    rules = fleet.spec.faults.rule
    assert [(rule.from_, rule.to) for rule in rules] == [(1, 2), (1, 2)]
    assert rules[0].faults["latency"].options["file"] == "lab.json"  # type: ignore[union-attr]
    assert rules[1].faults["bursts"].options["mean_length"] == 1.5  # type: ignore[union-attr]


def test_what_was_not_recorded_cannot_be_exported(agentd: Callable[..., Answer], tmp_path: Path) -> None:
    folder = tmp_path / "run"
    named(tmp_path, "", "time.duration=1.0", out=folder)
    answer = agentd("links", folder, "--export", tmp_path / "lab.json")
    assert answer.code != 0
    assert answer.err == f"agentd: {folder}: there is nothing to export: no latency or loss of any link was recorded\n"
    assert not (tmp_path / "lab.json").exists()
    assert "Links without faults lose and delay nothing in virtual time" in agentd("links", folder).out


def test_an_export_that_cannot_be_written_says_so(one: Path, agentd: Callable[..., Answer], tmp_path: Path) -> None:
    answer = agentd("links", one, "--export", tmp_path / "none" / "lab.json")
    assert answer.code != 0
    assert "lab.json: cannot be written: No such file or directory" in answer.err


@pytest.mark.real_time
def test_real_links_have_latencies_and_clock_offsets(agentd: Callable[..., Answer], tmp_path: Path) -> None:
    (tmp_path / "trio.toml").write_text(TRIO)
    with Launch(tmp_path / "trio.toml", tmp_path / "run", "time.duration=2.0") as launch:
        assert launch.end(60) == 0
    table = agentd("links", tmp_path / "run").out
    assert "wall clock" in table
    assert "latencies include waiting for the loop" in table
    assert "±" in row(table, "1 → 2")
    links = json.loads(agentd("links", tmp_path / "run", "--json").out)["links"]
    assert len(links) == 6
    for link in links:
        assert 0 < link["latency"]["median"] < 0.1
        assert link["loss"] == 0.0
        assert abs(link["clock_ahead"]) <= link["clock_error"] + 1e-3
    answer = agentd("links", tmp_path / "run", "--export", tmp_path / "lab.json")
    assert answer.code == 0
    assert len(read_profile(tmp_path / "lab.json")) == 6
    why = agentd("why", tmp_path / "run")
    assert why.code == 0
    assert "mean latency" in why.out


@pytest.mark.real_time
def test_a_link_that_was_dead_on_the_wall_clock_is_dead_in_the_replay(
    agentd: Callable[..., Answer], tmp_path: Path
) -> None:
    bare = TRIO.replace("[problem]", LOSSY_ROUNDS + "[problem]")
    (tmp_path / "dead.toml").write_text(f"{bare}\n[[faults.rule]]\nfrom = 1\nto = 2\nloss = 1.0\n")
    with Launch(tmp_path / "dead.toml", tmp_path / "run", "time.duration=2.0") as launch:
        assert launch.end(60) == 0
    answer = agentd("links", tmp_path / "run", "--export", tmp_path / "lab.json")
    assert "lab.json: profile of 5 of 6 links" in answer.err
    (tmp_path / "replay.toml").write_text(bare + answer.out)
    assert agentd("check", tmp_path / "replay.toml").code == 0
    again = simulate(tmp_path / "replay.toml", changes=["time.duration=2.0", "time.clock=virtual"])
    for before, after in zip(link_health(Run.read(tmp_path / "run")), link_health(again), strict=True):
        link = before.sender, before.receiver
        assert before.loss == after.loss == (link == (1, 2)), link
        if link != (1, 2):
            assert before.latency(0.25) <= after.latency(0.5) <= before.latency(0.75), link  # type: ignore[operator]
