from pathlib import Path

import pytest

from dcf_zenoh.config import load
from dcf_zenoh.spec import Faults, FaultTable
from tests.support.fleet_files import problems
from tests.support.lossy_fleets import BEARS_LOSS, lossy

LOSS = 'kind = "loss", probability = '


def faults(folder: Path, text: str, *changes: str) -> Faults:
    return load(lossy(folder, text), changes=changes).spec.faults


def table(kind: str, **options: object) -> FaultTable:
    return FaultTable.model_validate({"kind": kind, **options})


def test_target_is_understood(tmp_path: Path) -> None:
    spec = load(lossy(tmp_path)).spec
    latency = table("latency", distribution="uniform", low=0.0002, high=0.0008, reorder=True)
    assert spec.faults.everywhere == {"latency": latency}
    bad_link, split = spec.faults.rule
    assert (bad_link.from_, bad_link.to, bad_link.during) == (2, 3, None)
    assert bad_link.faults == {"bursts": table("bursts", mean_loss=0.2, mean_length=4, loss_good=0.0, loss_bad=1.0)}
    assert (split.from_, split.to, split.during) == (None, None, (4.0, 4.5))
    assert split.faults == {"partition": table("partition", groups=[[1, 2], [3, 4]])}


@pytest.mark.parametrize(
    "text",
    [
        "[faults]\nloss = 0.2",
        "[faults]\nloss = { probability = 0.2 }",
        "[faults]\nloss = { value = 0.2 }",
        "[faults.loss]\nkind = 'loss'\nprobability = 0.2",
        "[faults]\nloss = 0.1\n[[faults.rule]]\nfrom = 1\nbursts = false",
    ],
)
def test_bare_value_is_the_first_key_and_the_name_is_the_kind(tmp_path: Path, text: str) -> None:
    found = faults(tmp_path, text, *(["faults.loss=0.2", "faults.rule=[]"] if "0.1" in text else []))
    assert found == Faults.model_validate({"loss": table("loss", probability=0.2)})


def test_bare_value_is_the_first_key_of_a_third_party_kind_too(tmp_path: Path) -> None:
    text = "[faults]\na = { kind = './mine.py:Dull', value = 3 }\n[[faults.rule]]\nto = 1\na = 4"
    found = faults(tmp_path, text)
    assert found.everywhere == {"a": table("./mine.py:Dull", often=3)}
    assert found.rule[0].faults == {"a": table("./mine.py:Dull", often=4)}  # the kind of [faults.a]


def test_bare_value_is_spelled_out_without_running_third_party_code(tmp_path: Path) -> None:
    path = lossy(tmp_path, "[faults]\na = { kind = './mine.py:Dull', value = 3 }\nloss = 0.1")
    with (tmp_path / "mine.py").open("a") as file:
        file.write("\n1 / 0")
    fleet = load(path, changes=[BEARS_LOSS], run_plugins=False)
    assert fleet.spec.faults.everywhere == {
        "a": table("./mine.py:Dull", often=3),
        "loss": table("loss", probability=0.1),
    }
    assert fleet.notes == ("faults.a: ./mine.py:Dull was not run, so its keys are checked by name at most",)


def test_what_is_switched_off_everywhere_is_not_there(tmp_path: Path) -> None:
    assert faults(tmp_path, "[faults]\nloss = false") == Faults()
    text = "[faults]\nloss = 0.1\nodd = { kind = './mine.py:Dull' }"
    assert faults(tmp_path, text, "faults.loss=false", "faults.odd=false") == Faults()


def test_rule_keeps_what_it_switches_off(tmp_path: Path) -> None:
    text = "[faults]\nloss = 0.1\n[[faults.rule]]\nfrom = [1, 2]\nloss = false"
    (rule,) = faults(tmp_path, text).rule
    assert (rule.from_, rule.faults) == ((1, 2), {"loss": False})


@pytest.mark.parametrize(
    ("changes", "probability"),
    [
        (["faults.loss=0.3"], 0.3),
        (["faults.loss.probability=0.3"], 0.3),
        (["faults.loss=0", "faults.loss.probability=0.3"], 0.3),
        (["faults.loss=false", "faults.loss.probability=0.3"], 0.3),
        (["faults.loss.kind=loss", "faults.loss.probability=0.3"], 0.3),
        (["faults={loss = 0.3}"], 0.3),
    ],
)
def test_fault_is_set_from_outside(tmp_path: Path, changes: list[str], probability: float) -> None:
    for text in ("", "[faults]\nloss = 0.1"):
        assert faults(tmp_path, text, *changes).everywhere == {"loss": table("loss", probability=probability)}


def test_other_kind_drops_the_keys_of_the_old_one_with_a_note(tmp_path: Path) -> None:
    text = "[faults]\nloss = 0.1\n[[faults.rule]]\nto = 1\nloss = 0.2"
    keys = ["kind=bursts", "mean_loss=0.1", "mean_length=2"]
    changes = [f"{key}.loss.{each}" for key in ("faults", "faults.rule.1") for each in keys]
    fleet = load(lossy(tmp_path, text), changes=[*changes, BEARS_LOSS])
    bursts = table("bursts", mean_loss=0.1, mean_length=2, loss_good=0.0, loss_bad=1.0)
    assert fleet.spec.faults.everywhere == fleet.spec.faults.rule[0].faults == {"loss": bursts}
    assert fleet.notes == (
        "faults.loss: kind changed from loss to bursts, dropped probability",
        "faults.rule.1.loss: kind changed from loss to bursts, dropped probability",
    )


def test_rules_are_set_from_outside(tmp_path: Path) -> None:
    (rule,) = faults(tmp_path, "", "faults.rule=[{from=1,to=2,loss=0.3}]").rule
    assert (rule.from_, rule.to, rule.faults) == (1, 2, {"loss": table("loss", probability=0.3)})
    changes = ["faults.rule.1.to=[2, 4]", "faults.rule.1.from=1", "faults.rule.1.loss=0.3", "faults.rule.2.noise=1"]
    first, second = faults(tmp_path, "", *changes).rule
    assert (first.from_, first.to, first.faults) == (1, (2, 4), {"loss": table("loss", probability=0.3)})
    assert second.faults == {"noise": table("noise", std=1, names=[])}


def test_rule_of_the_file_is_changed_by_its_number(tmp_path: Path) -> None:
    spec = load(lossy(tmp_path), changes=["faults.rule.1.bursts.mean_loss=0.1", "faults.rule.2.during=[1, 2]"]).spec
    first, second = spec.faults.rule
    assert first.faults["bursts"] == table("bursts", mean_loss=0.1, mean_length=4, loss_good=0.0, loss_bad=1.0)
    assert second.during == (1.0, 2.0)


def test_faults_of_an_agent_are_set_from_outside(tmp_path: Path) -> None:
    own = load(lossy(tmp_path, ""), changes=["agents.1.faults.crash.at=8"]).spec.agents[1]
    assert own.faults.crash is not None
    assert own.faults.crash.at == 8.0


def test_file_given_by_an_argument_is_looked_for_in_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "tale.txt").write_text("once")
    (tmp_path / "beside.txt").write_text("twice")
    path = lossy(tmp_path, "[faults]\na = { kind = './mine.py:Told', story = 'beside.txt' }")
    monkeypatch.chdir(tmp_path / "here")
    told = str(tmp_path / "here" / "tale.txt")
    rule = "faults.rule=[{to=1,a={story='tale.txt'}},{to=2,a='beside.txt'}]"
    for change in ("faults.a.story=tale.txt", "faults.a={kind='./mine.py:Told',value='tale.txt'}"):
        spec = load(path, changes=[change, rule]).spec
        assert spec.faults.everywhere == {"a": table("./mine.py:Told", story=told, pace=1.0)}
        assert spec.faults.rule[0].faults == {"a": table("./mine.py:Told", story=told, pace=1.0)}
        assert spec.faults.rule[1].faults == {"a": table("./mine.py:Told", story="beside.txt", pace=1.0)}
    assert load(path, changes=["faults.a.pace=2"]).spec.faults.everywhere["a"] == table(
        "./mine.py:Told", story="beside.txt", pace=2
    )


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("faults=3", "faults: expected a table (what the network does to messages), not 3"),
        ("faults.rule=3", "faults.rule: expected a list of tables, each under [[faults.rule]], not 3"),
        (
            "faults.rule={from=1}",
            "faults.rule: expected a list of tables, each under [[faults.rule]], not {'from': 1}",
        ),
        ("faults.rule.2=3", "faults.rule.2: expected a table, not 3"),
        ("faults.rule.4.loss=0.2", "faults.rule.4: cannot be set: the next rule is faults.rule.3"),
        (
            "faults.rule.two.loss=0.2",
            "faults.rule.two.loss: cannot be set: rules have numbers, from 1 on in the order of the file",
        ),
        (
            "faults.loss={value=0.2,probability=0.1}",
            "faults.loss.value: given twice: also as faults.loss.probability",
        ),
        ("faults.loss.kind=3", "faults.loss.kind: expected a string, not 3"),
        ("faults.rule.1.loss={kind=true}", "faults.rule.1.loss.kind: expected a string, not true"),
        (
            "faults.during=[1,2]",
            "faults.during: expected in a [[faults.rule]]; faults in [faults] itself are those of all links",
        ),
        (
            "faults.rule.1.from=2.5",
            "faults.rule.1.from: expected a whole number >= 0 or a list of whole numbers (sending agents; none: all),"
            " not 2.5",
        ),
        (
            "faults.rule.1.to=[1, -2]",
            "faults.rule.1.to: expected a whole number >= 0 or a list of whole numbers (receiving agents; none: all),"
            " not [1, -2]",
        ),
        (
            "faults.rule.2.during=4",
            "faults.rule.2.during: expected a list of 2 numbers (begin and end of the instants at which messages enter"
            " the link, s; none: always), not 4",
        ),
    ],
)
def test_what_cannot_be_understood_is_named(tmp_path: Path, change: str, problem: str) -> None:
    assert problems(lossy(tmp_path), change) == [problem]


def test_rules_keep_their_numbers_when_one_is_wrong(tmp_path: Path) -> None:
    assert problems(lossy(tmp_path), "faults.rule.1=3", "faults.rule.2.from=-1", "faults.rule.3.loss=2") == [
        "faults.rule.1: expected a table, not 3",
        "faults.rule.2.from: expected a whole number >= 0 or a list of whole numbers (sending agents; none: all),"
        " not -1",
        "faults.rule.3.loss.probability: must be a probability, from 0 to 1, not 2.0",
    ]
