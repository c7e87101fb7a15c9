import tomllib
from pathlib import Path
from typing import Any

import pytest

from dcf_zenoh.config import load, to_toml
from dcf_zenoh.errors import ConfigurationError

ODD = """
import numpy as np

class Odd:
    def __init__(
        self, *, target=(0.0, 0.0), said="a", flag=False, count=3, factor=0.5, nothing: float | None = None,
        nested=((1, 2), [3]), hole=(1.0, None), table={"a": 1}, array=np.ones(2), thing=object(), wrong: float = "big",
    ): raise AssertionError("nothing is constructed")
"""


def test_defaults_of_all_plugins_in_use_are_filled_in() -> None:
    spec = load("position_swap").spec
    assert spec.problem.options["barrier"]["radii"] == [0.5, 0.25]
    assert spec.problem.options["prediction"]["horizon"] == 3
    assert spec.algorithm.options == {"order": "adapt_then_combine", "step": 0.05, "multiplier_max": 1e3}
    assert spec.plants["point"].options == {"accel_max": 2.0}
    assert spec.controller is not None
    assert spec.controller.kind == "receding_horizon"


def test_defaults_are_written_out() -> None:
    table = tomllib.loads(to_toml(load("position_swap").spec))
    assert table["problem"]["barrier"]["radii"] == [0.5, 0.25]
    assert table["algorithm"]["multiplier_max"] == 1e3
    assert table["plants"]["point"] == {"kind": "point_mass", "accel_max": 2.0}
    assert table["controller"]["kind"] == "receding_horizon"


def test_file_wins_over_the_default_and_an_agent_over_the_file(file: Path) -> None:
    spec = load(file, changes=["agents.2.problem.sides=5"]).spec
    assert spec.problem.options == {"radius": 0.5, "sides": 3}
    assert [spec.agent(i).problem.options["sides"] for i in spec.ids] == [3, 5, 3]
    assert [spec.agent(i).problem.options["radius"] for i in spec.ids] == [0.5, 0.5, 1]
    assert [spec.agent(i).plant.options["accel_max"] for i in spec.ids] == [1, 2.5, 1]  # type: ignore[union-attr]


def test_agent_overrides_a_default_that_the_file_does_not_mention() -> None:
    spec = load("position_swap", changes=["agents.2.problem.cost.gather=3.0", "agents.3.plants.point.accel_max=9"]).spec
    assert [spec.agent(i).problem.options["cost"]["gather"] for i in spec.ids] == [1.0, 3.0, 1.0, 1.0]
    assert [spec.agent(i).plant.options["accel_max"] for i in spec.ids] == [2.0, 2.0, 9, 2.0]  # type: ignore[union-attr]


def test_default_of_none_stays_unsaid() -> None:
    fleet = load("position_swap")
    assert not {"relax", "dual", "blend"} & fleet.spec.algorithm.options.keys()  # None: it depends on the order
    assert "velocity" not in fleet.spec.plants["point"].options
    assert "relax" not in to_toml(fleet.spec)


def test_only_what_toml_can_say_and_the_plugin_accepts_is_filled_in(file: Path) -> None:
    (file.parent / "odd.py").write_text(ODD)
    spec = load(file, changes=["problem.kind=./odd.py:Odd"]).spec
    expected: dict[str, Any] = {"target": [0.0, 0.0], "said": "a", "flag": False, "count": 3, "factor": 0.5}
    assert spec.problem.options == {**expected, "nested": [[1, 2], [3]]}
    (file.parent / "again.toml").write_text(to_toml(spec))
    assert load(file.parent / "again.toml").spec == spec


def test_unused_tables_stay_as_they_are(file: Path) -> None:
    spec = load(file).spec
    assert spec.algorithm.options == {"step": 0.1, "relax": 1.0}
    assert spec.algorithms["fine"].options == {"relax": 0.5}


@pytest.mark.parametrize("run", [True, False])
def test_third_party_plugins_are_run_for_their_defaults_only_on_request(file: Path, run: bool) -> None:
    spec = load(file, run_plugins=run).spec
    assert ("sides" in spec.problem.options) is run
    assert spec.topology.options == {"directed": False}  # built in


def test_what_all_agents_must_share_cannot_be_overridden_by_one() -> None:
    with pytest.raises(ConfigurationError) as caught:
        load(
            "position_swap",
            changes=["agents.2.problem.barrier.radii=[1.0, 1.0]", "agents.3.problem.prediction.horizon=4"],
        )
    assert caught.value.problems == (
        "agents.2.problem.barrier.radii: must be the same at every agent; set it in [problem]",
        "agents.3.problem.prediction.horizon: must be the same at every agent; set it in [problem]",
    )


def test_numbers_that_are_none_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"algorithm\.step: expected a finite number, not nan"):
        load("position_swap", changes=["algorithm.step=nan"])
