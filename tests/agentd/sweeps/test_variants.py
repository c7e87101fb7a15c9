import pytest

from agentd.sweeps.variants import Variant, load_all, variants
from dcf_zenoh.config import LoadedFleet, load
from dcf_zenoh.errors import ConfigurationError


def test_several_keys_make_all_combinations_and_the_last_changes_fastest() -> None:
    found = variants(["plant=point,twin", "seed=1,2"], 4)
    assert [each.name for each in found] == [
        "plant=point, seed=1", "plant=point, seed=2", "plant=twin, seed=1", "plant=twin, seed=2",
    ]  # fmt: skip
    assert [each.choice("plant") for each in found] == ["point", "point", "twin", "twin"]
    assert found[0].choice("algorithm") is None
    assert found[-1].changes == ["seed=2"]


def test_options_of_the_command_line_stand_for_their_keys() -> None:
    (found,) = variants(["topology=ring", "clock=wall", "exchange.max_rounds=40", "algorithm=trades"], 1)
    assert found.changes == ["topology.kind=ring", "time.clock=wall", "exchange.max_rounds=40"]
    assert found.choice("algorithm") == "trades"


def test_commas_in_brackets_and_quotes_divide_nothing() -> None:
    found = variants(
        ["problem.barrier.radii=[0.5, 0.25],[0.6,0.3]", "faults.loss={ probability = 0.1, kind = 'a,]b' },0.2"], 4
    )
    assert [list(each.values.values()) for each in found] == [
        ["[0.5, 0.25]", "{ probability = 0.1, kind = 'a,]b' }"],
        ["[0.5, 0.25]", "0.2"],
        ["[0.6,0.3]", "{ probability = 0.1, kind = 'a,]b' }"],
        ["[0.6,0.3]", "0.2"],
    ]


def test_numbers_and_booleans_are_different_values() -> None:
    assert len(variants(["log.rounds=true,1"], 9)) == 2


FORM = "expected KEY=VALUE,VALUE, such as plant=point,twin"
TWICE = "given twice; put all its values into one, with commas"


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (["plant"], f"--vary plant: {FORM}"),
        (["=point"], f"--vary =point: {FORM}"),
        (["plant="], f"--vary plant=: no values; {FORM}"),
        (["plant=,"], f"--vary plant=,: no values; {FORM}"),
        (["plant=point,,twin"], f"--vary plant=point,,twin: a value is missing beside a comma; {FORM}"),
        (["plant=point,point"], "--vary plant: point is given twice; each variant is run once"),
        (["time.duration=2.0,1.0,2"], "--vary time.duration: 2 is given twice; each variant is run once"),
        (["seed=1,2", "seed=3"], f"--vary seed: {TWICE}"),
        (["topology=ring", "topology.kind=star"], f"--vary topology.kind: {TWICE}"),
        (["agents.1.start=[1,0]", "agents.01.start=[0,1]"], f"--vary agents.01.start: {TWICE}"),
        (["seed=1,2,3", "plant=a,b"], "--vary: 3 x 2 values make 6 variants; at most 5 are allowed"),
    ],
)  # fmt: skip
def test_text_that_makes_no_variants_is_refused_in_one_line(texts: list[str], expected: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        variants(texts, 5)
    assert str(caught.value) == expected


def average(variant: Variant) -> LoadedFleet:
    return load("average", changes=variant.changes)


def test_fleets_come_in_the_order_of_their_variants() -> None:
    assert [each.spec.seed for each in load_all(variants(["seed=7,3"], 2), average)] == [7, 3]


def test_problem_of_all_variants_is_reported_once_and_of_one_with_its_name() -> None:
    chosen = variants(["time.durration=1,2", "time.sample_time=0.1,-1.0"], 4)
    with pytest.raises(ConfigurationError) as caught:
        load_all(chosen, average)
    assert [each.partition(": [")[0].partition(": expected")[0] for each in caught.value.problems] == [
        "time.durration",
        "time.durration=1, time.sample_time=-1.0: time.sample_time",
    ]
    assert caught.value.source.endswith("average.toml")
