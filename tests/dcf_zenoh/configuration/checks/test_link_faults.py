from pathlib import Path

import pytest

from agentd.cli import main
from dcf_zenoh.config import load
from tests.support.fleet_files import problems
from tests.support.lossy_fleets import BEARS_LOSS, lossy

KNOWN = (
    "known faults: bandwidth, bursts, duplication, latency, loss, noise, partition, quantisation, range, switching,"
    " tampering; or a table with kind = 'package.module:Name' or './file.py:Name'"
)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("faults.lsos=0.2", f"faults.lsos: unknown fault 'lsos'; did you mean 'loss'? {KNOWN}"),
        ("faults.latnecy=false", f"faults.latnecy: unknown fault 'latnecy'; did you mean 'latency'? {KNOWN}"),
        ("faults.rules=[]", f"faults.rules: unknown fault 'rules'; did you mean 'rule'? {KNOWN}"),
        ("faults.rule.1.form=2", f"faults.rule.1.form: unknown fault 'form'; did you mean 'from'? {KNOWN}"),
        ("faults.rule.2.odd=false", f"faults.rule.2.odd: unknown fault 'odd'; {KNOWN}"),
        ("faults.a.kind=busrts", "faults.a.kind: unknown kind 'busrts'; did you mean 'bursts'? known faults: "),
        ("faults.a.kind=./my.py:A", "faults.a.kind: ./my.py:A: cannot read "),
        ("faults.a.kind=./mine.py:Duller", "faults.a.kind: ./mine.py:Duller: "),
        ("faults.loss=1.3", "faults.loss.probability: must be a probability, from 0 to 1, not 1.3"),
        ("faults.loss=nan", "faults.loss.probability: expected a finite number, not nan"),
        ("faults.loss=much", "faults.loss.probability: expected a number, not 'much'"),
        ("faults.loss=true", "faults.loss.probability: expected a number, not true"),
        ("faults.loss={}", "faults.loss.probability: missing; Loss needs a number"),
        ("faults.latency={}", "faults.latency.mean: is missing: distribution 'constant' takes mean"),
        (
            "faults.rule.1.bursts.mean_los=0.1",
            "faults.rule.1.bursts.mean_los: Bursts has no key 'mean_los'; did you mean 'mean_loss'? accepted: ",
        ),
        (
            "faults.rule.1.bursts={}",
            "faults.rule.1.bursts: good_to_bad and bad_to_good must be given together, or mean_loss and mean_length",
        ),
        ("faults.a={kind='./mine.py:Dull',often=10}", "faults.a.often: must be at most 9, not 10"),
        ("faults.a={kind='./mine.py:Dull',often=-1}", "faults.a: KeyError: 'oops'"),
        ("faults.a={kind='./mine.py:wrong'}", "faults.a: wrong made a str, not a Fault"),
        ("faults.a={kind='./mine.py:Keyless',value=1}", "faults.a.value: Keyless has no key 'value'; accepted: none"),
        ("faults.rule.1.from=[2,9]", "faults.rule.1.from: there is no agent 9; agents are 1, 2, 3, 4"),
        ("faults.rule.1.to=[]", "faults.rule.1.to: expected at least one agent; without this key it is for all"),
        ("faults.rule.1.to=2", "faults.rule.1.to: expected another agent than 2, as from; none has a link to itself"),
        (
            "faults.rule.1.to=4",
            "faults.rule.1: no link from 2 to 4 in topology 'ring'; links there are: 1 -> 4, 2 -> 1, 2 -> 3, 3 -> 4",
        ),
        ("faults.rule.1.bursts=false", ""),
        ("faults.rule.2.during=[4.5,4.0]", "faults.rule.2.during: expected begin < end, not [4.5, 4]"),
        ("faults.rule.2.during=[4,4]", "faults.rule.2.during: expected begin < end, not [4, 4]"),
        (
            "faults.rule.2.during=[25,26]",
            "faults.rule.2.during: expected within the run, which ends at 25 s, not 25 s",
        ),
        ("faults.rule.2.during=[24,1e300]", "faults.rule.2.during: expected at most 1e+08 s, not 1e+300"),
        (
            "faults.rule.3.to=1",
            "faults.rule.3: a rule without a fault; known faults: bandwidth, bursts, duplication, latency, ",
        ),
        (
            "faults.rule.2.partition=[[1,2],[3,2]]",
            "faults.rule.2.partition.groups: must name an agent once, not agent 2 twice",
        ),
        (
            "faults.rule.2.partition=[[1,2],[3,'4']]",
            "faults.rule.2.partition.groups: expected a list of lists of whole numbers, not [[1, 2], [3, '4']]",
        ),
        (
            "faults.a={kind='./mine.py:Jammer',victims=[[1],[2,7]]}",
            "faults.a.victims: there is no agent 7; agents are 1, 2, 3, 4",
        ),
        ("faults.a={kind='./mine.py:Told',story='tale.txt'}", "faults.a.story: there is no file "),
    ],
)
def test_mistake_is_reported_in_one_line_with_its_key(tmp_path: Path, change: str, problem: str) -> None:
    if not problem:
        assert load(lossy(tmp_path), changes=[change]).spec.faults.rule[0].faults == {"bursts": False}
        return
    (found,) = problems(lossy(tmp_path), change)
    assert found.startswith(problem)


def test_command_line_names_the_file_and_the_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = lossy(tmp_path)
    assert main(["check", str(path), "--set", "faults.loss.probability=1.3"]) != 0
    text = f"{path}: faults.loss.probability: must be a probability, from 0 to 1, not 1.3"
    assert text in capsys.readouterr().err.replace("\n", " ").replace("agentd: ", "")


def test_plugins_of_faults_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plugins", "faults"]) == 0
    text = capsys.readouterr().out
    assert "\n  loss           Messages that get lost" in text or "\n  loss           Every message is lost" in text
    assert "\n    probability: number, required\n" in text


def test_third_party_faults_are_constructed_only_on_request(tmp_path: Path) -> None:
    path = lossy(tmp_path, "[faults]\na = { kind = './mine.py:Dull', often = 99 }\nloss = 1.3")
    assert problems(path, run_plugins=False) == ["faults.loss.probability: must be a probability, from 0 to 1, not 1.3"]


def test_link_is_not_missed_where_the_topology_was_not_drawn(tmp_path: Path) -> None:
    (tmp_path / "wheel.py").write_text("def wheel(agents):\n    yield from zip(agents, (*agents[1:], agents[0]))")
    path = lossy(tmp_path, "[[faults.rule]]\nfrom = 2\nto = 4\nloss = 0.1", "./wheel.py:wheel")
    assert load(path, run_plugins=False).spec.faults.rule
    assert problems(path) == [
        "faults.rule.1: no link from 2 to 4 in topology './wheel.py:wheel'; links there are: 2 -> 3, 3 -> 4"
    ]


def test_many_links_are_cut_short(tmp_path: Path) -> None:
    hub = "topology={kind='star',hub=1}"
    agents = [f"agents.{i}={{start=[{i}.0, 5.0], target=[0.0, {i}.0]}}" for i in range(5, 18)]
    (found,) = problems(
        lossy(tmp_path, "[[faults.rule]]\nfrom = [2, 3]\nto = [4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14]\nloss = 0.1"),
        hub,
        *agents,
    )
    assert found.startswith("faults.rule.1: no link from 2, 3 to 4, 5, 6, ")
    assert found.endswith("1 -> 13, 1 -> 14, ...") or found.endswith(", ...")
    assert found.count("->") == 12


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[faults]\nloss = 0.1\n[[faults.rule]]\nloss = 0.2", "faults.loss: never acts, as faults.rule.1.loss"),
        (
            "[[faults.rule]]\nfrom = 1\nto = 2\nduring = [1, 2]\nloss = 0.1\n"
            "[[faults.rule]]\nnoise = 1\n"
            "[[faults.rule]]\nfrom = [1, 3]\nduring = [0, 2]\nloss = false",
            "faults.rule.1.loss: never acts, as faults.rule.3.loss",
        ),
        (  # on the ring, 1 has links to 2 and 4 only
            "[[faults.rule]]\nfrom = 1\nloss = 0.1\n[[faults.rule]]\nfrom = 1\nto = [2, 4]\nloss = 0.2",
            "faults.rule.1.loss: never acts, as faults.rule.2.loss",
        ),
    ],
)
def test_rule_that_can_never_act_names_the_one_that_wins(tmp_path: Path, text: str, problem: str) -> None:
    expected = f"{problem} comes later, for at least the same links and times"
    assert problems(lossy(tmp_path, text)) == [expected]


def test_rule_that_later_ones_cover_together_names_them(tmp_path: Path) -> None:
    first = "[[faults.rule]]\nfrom = 1\nduring = [1, 3]\nloss = 0.5\n"
    second = "[[faults.rule]]\nfrom = [1, 2]\nduring = [1, {end}]\nloss = 0.1\n"
    third = "[[faults.rule]]\nduring = [2, 3]\nloss = 0.2\n"
    assert problems(lossy(tmp_path, first + second.format(end=2) + third)) == [
        "faults.rule.1.loss: never acts, as faults.rule.2.loss, faults.rule.3.loss come later, together for at least"
        " the same links and times"
    ]
    assert load(lossy(tmp_path, first + second.format(end=1.9) + third), changes=[BEARS_LOSS]).notes == ()


@pytest.mark.parametrize(
    "later",
    ["from = 1\nloss = 0.2", "during = [0, 24]\nloss = 0.2", "noise = 1"],
)
def test_rule_that_acts_on_some_links_or_at_some_times_is_none_too_many(tmp_path: Path, later: str) -> None:
    assert load(lossy(tmp_path, f"[faults]\nloss = 0.1\n[[faults.rule]]\n{later}"), changes=[BEARS_LOSS]).notes == ()


def test_cut_that_lasts_is_noted(tmp_path: Path) -> None:
    path = lossy(tmp_path)
    assert load(path, changes=[BEARS_LOSS]).notes == ()
    assert load(path, changes=["faults.rule.2.during=[4,6]", BEARS_LOSS]).notes == (
        "faults.rule.2.partition: the run ends when a link is cut for more than 0.6 s,"
        " by safety.neighbour_silent.then = 'land'; 'continue' goes on",
    )
    changes = [BEARS_LOSS, "faults.rule.2.during=[4,6]", "safety.neighbour_silent.then=continue"]
    assert load(path, changes=changes).notes == ()


def test_positions_are_needed_where_there_are_any(tmp_path: Path) -> None:
    (tmp_path / "mean.toml").write_text(
        "name = 'mean'\nproblem = { kind = 'average' }\nalgorithm = { kind = 'average_consensus' }\n"
        "exchange = { round_timeout = 0.001 }\n"
        "agents.1.problem.value = 1.0\nagents.2.problem.value = 2.0\nfaults = { range = 2.0 }\n"
    )
    assert problems(tmp_path / "mean.toml") == [
        "faults.range: needs the positions of the agents, and without plants they have none"
    ]
