"""``agentd compare``: variants of a fleet side by side."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import dcf_zenoh
from agentd.figures.comparison import comparison
from dcf_zenoh import Run
from dcf_zenoh.analysis.metrics import overshoot, tracking_error
from tests.support.command_line import Answer
from tests.support.daemons import TRIO

SHORT = ("--set", "time.duration=1.0")

MINE = """
from dcf_zenoh.algorithms.trades import trades
from plants.point_mass import PointMass

def brittle(problem, me, *, breaks: bool = False):
    if breaks:
        raise ZeroDivisionError("as asked")
    return (yield from trades(problem, me))

class Model(PointMass):
    pass

class Real(PointMass):
    real = True
"""


@pytest.fixture
def trio(tmp_path: Path) -> Path:
    (tmp_path / "trio.toml").write_text(f'{TRIO}\n[plants.heavy]\nkind = "point_mass"\naccel_max = 1.0\n')
    (tmp_path / "mine.py").write_text(MINE)
    return tmp_path / "trio.toml"


def test_every_variant_has_a_run_of_its_own_that_is_what_simulate_makes(
    trio: Path, agentd: Callable[..., Answer]
) -> None:
    folder = trio.parent / "both"
    answer = agentd("compare", trio, *SHORT, "--vary", "plant=point,heavy", "--out", folder, "--json")
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.count("\n") == 1
    found = json.loads(answer.out)
    assert (found["fleet"], found["folder"]) == ("trio", str(folder))
    for variant, plant in zip(found["variants"], ("point", "heavy"), strict=True):
        alone = dcf_zenoh.simulate(trio, plant=plant, changes=["time.duration=1.0"])
        assert variant["variant"] == f"plant={plant}"
        assert variant["failed"] is None
        assert variant["digest"] == alone.digest == Run.read(variant["run"]).digest
        assert variant["overshoot"] == overshoot(alone)
        assert variant["tracking_error"] == tracking_error(alone)
        assert variant["min_barrier"] == alone.summary()["min_barrier"]
    assert {path.name for path in folder.iterdir()} == {
        "01-plant-point", "02-plant-heavy", "comparison.csv", "comparison.png", "comparison.pdf",
    }  # fmt: skip
    with (folder / "comparison.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["min_barrier"]) for row in rows] == [each["min_barrier"] for each in found["variants"]]
    assert rows[0].keys() == found["variants"][0].keys()


def test_compare_prints_a_table_with_a_row_for_each_variant(trio: Path, agentd: Callable[..., Answer]) -> None:
    words = ["--vary", "exchange.max_rounds=10,40", "--vary", "seed=1,2", "--out", trio.parent / "four"]
    answer = agentd("compare", trio, *SHORT, *words)
    assert answer.code == 0
    lines = [" ".join(line.split()) for line in answer.out.splitlines()]
    rows = [line for line in lines if line.startswith("exchange.max_rounds=")]
    assert len(rows) == 4
    assert rows[0].startswith("exchange.max_rounds=10, seed=1 not all 0.000")
    assert rows[0].endswith("10 0 0 0 of 15")
    assert lines[-1].endswith("four: the runs, and comparison.csv, comparison.png, comparison.pdf")
    assert answer.err.splitlines() == [
        f"agentd: {number} of 4: exchange.max_rounds={rounds}, seed={seed}"
        for number, (rounds, seed) in enumerate(((10, 1), (10, 2), (40, 1), (40, 2)), start=1)
    ]


def test_failure_of_a_variant_is_reported_and_the_others_run(trio: Path, agentd: Callable[..., Answer]) -> None:
    words = ["--algorithm", f"{trio.parent}/mine.py:brittle", "--vary", "algorithm.breaks=true,false"]
    answer = agentd("compare", trio, *SHORT, *words, "--out", trio.parent / "two", "--json")
    assert answer.code == 1
    broken, whole = json.loads(answer.out)["variants"]
    assert "ZeroDivisionError: as asked (mine.py:7)" in broken["failed"]
    assert answer.err == f"agentd: algorithm.breaks=true: failed: {broken['failed']}\n"
    assert broken["min_barrier"] is broken["digest"] is None
    assert whole["failed"] is None
    assert whole["min_barrier"] > 0
    answer = agentd("compare", trio, *SHORT, *words, "--out", trio.parent / "again")
    assert answer.code == 1
    assert any(line.split() == ["algorithm.breaks=true", "failed"] for line in answer.out.splitlines())


@pytest.mark.real_time
def test_daemons_and_simulator_can_be_compared(trio: Path, agentd: Callable[..., Answer]) -> None:
    answer = agentd("compare", trio, *SHORT, "--vary", "clock=virtual,wall", "--json", "--out", trio.parent / "two")
    assert answer.code == 0, answer.err
    virtual, wall = json.loads(answer.out)["variants"]
    assert (virtual["clock"], wall["clock"]) == ("virtual", "wall")
    assert virtual["negotiation_max_ms"] == 0 < wall["negotiation_median_ms"]
    assert "exit_codes" in Run.read(wall["run"]).about  # daemons were launched
    assert "exit_codes" not in Run.read(virtual["run"]).about


def test_launch_makes_daemons_of_all_variants(trio: Path, agentd: Callable[..., Answer]) -> None:
    words = ["--launch", "--clock", "virtual", "--vary", "plant=point,heavy", "--out", trio.parent / "two", "--json"]
    answer = agentd("compare", trio, *SHORT, *words)
    assert answer.code == 0, answer.err
    for each in json.loads(answer.out)["variants"]:
        assert "exit_codes" in Run.read(each["run"]).about
        plant = each["variant"].removeprefix("plant=")
        assert each["digest"] == dcf_zenoh.simulate(trio, plant=plant, changes=["time.duration=1.0"]).digest


@pytest.mark.real_time
def test_a_real_plant_is_launched_on_the_wall_clock(trio: Path, agentd: Callable[..., Answer]) -> None:
    file = trio.parent / "mine.py"
    words = ["--vary", f"plant={file}:Model,{file}:Real", "--out", trio.parent / "two", "--json"]
    answer = agentd("compare", trio, *SHORT, *words, "--yes")
    assert answer.code == 0, answer.err
    assert [each["clock"] for each in json.loads(answer.out)["variants"]] == ["virtual", "wall"]
    answer = agentd("compare", trio, "--clock", "virtual", *words[:2])
    assert answer.code == 2
    assert answer.err.startswith(f"agentd: {trio}: plant={file}:Real: plants.")
    assert answer.err.endswith(": moves in the real world, which knows no virtual time: launch it with --clock wall\n")


BAD = {
    "unknown key": (
        ["time.durration=1,2"],
        "time.durration: [time] has no key 'durration'; did you mean 'duration'? accepted: clock, sample_time,"
        " duration, arrived",
    ),
    "unknown plant": (
        ["plant=point,poimt"],
        "plant=poimt: plant: there is no [plants.poimt] and no kind 'poimt'; did you mean 'point'? tables: point,"
        " heavy; known plants: ",
    ),
    "unknown algorithm": (
        ["algorithm=tradse,trades"],
        "algorithm=tradse: algorithm: there is no [algorithms.tradse] and no kind 'tradse'; did you mean 'trades'?",
    ),
    "unknown value": (
        ["seed=1,one"],
        "seed=one: seed: expected a whole number >= 0, not 'one'",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_error_in_a_variant_is_reported_before_any_run(case: str, trio: Path, agentd: Callable[..., Answer]) -> None:
    texts, expected = BAD[case]
    answer = agentd("compare", trio, *(word for text in texts for word in ("--vary", text)), "--out", trio.parent / "x")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.count("\n") == 1
    assert answer.err.startswith(f"agentd: {trio}: {expected}")
    assert not (trio.parent / "x").exists()


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ("plant=", "--vary plant=: no values; expected KEY=VALUE,VALUE, such as plant=point,twin"),
        ("plant=point", "--vary: one variant alone; give at least two values, such as plant=point,twin"),
        ("plant=point,point", "--vary plant: point is given twice; each variant is run once"),
        (f"seed={','.join(map(str, range(13)))}", "--vary: 13 values make 13 variants; at most 12 are allowed"),
    ],
)
def test_wrong_list_of_values_is_reported_in_one_line(
    values: str, expected: str, agentd: Callable[..., Answer]
) -> None:
    assert agentd("compare", "position_swap", "--vary", values) == (2, "", f"agentd: {expected}\n")


@pytest.fixture(scope="module")
def swap() -> Run:
    return dcf_zenoh.simulate("position_swap", changes=["time.duration=2.0"])


def drawn(variants: dict[str, Run | str]) -> list[Axes]:
    figure = comparison(variants)
    assert isinstance(figure, Figure)
    return figure.axes


def test_the_figure_has_a_panel_for_every_variant_on_the_same_axes_and_times_below(swap: Run) -> None:
    one, other, broken, *below = drawn({"seed=1": swap, "seed=2": swap, "seed=3": "no radio was found"})
    assert one.get_xlim() == other.get_xlim() == broken.get_xlim()
    assert one.get_title().splitlines()[:2] == ["1: seed=1", "did not arrive, virtual clock"]
    assert "closest at" in one.get_title()
    assert [text.get_text() for text in broken.texts] == ["failed: no radio was found"]
    assert [axes.get_ylabel() for axes in below] == [
        "time per step in ms, model time", "time per step in ms, real time", "rounds per step",
    ]  # fmt: skip
    assert [label.get_text() for label in below[0].get_xticklabels()] == ["seed=1", "seed=2"]
    paths = [line.get_xydata() for line in one.lines if len(np.asarray(line.get_xdata())) > 1]
    np.testing.assert_array_equal(paths[0], swap.agents[1].path)


def test_boxes_of_many_variants_have_numbers(swap: Run) -> None:
    *panels, _, _, rounds = drawn({f"seed={seed}": swap for seed in range(6)})
    assert len(panels) == 6
    assert [label.get_text() for label in rounds.get_xticklabels()] == ["1", "2", "3", "4", "5", "6"]
    assert not rounds.texts


def test_variants_that_compute_only_have_times_and_no_paths() -> None:
    run = dcf_zenoh.simulate("average")
    assert len(drawn({"seed=1": run, "seed=2": run})) == 3
    assert comparison({"seed=1": "it failed"}) is None
