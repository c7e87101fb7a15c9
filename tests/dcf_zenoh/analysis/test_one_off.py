"""Plug-ins that leave out what their algorithm never calls, and refusals before the start instead of in it."""

from collections.abc import Callable
from pathlib import Path

import pytest

import dcf_zenoh
from dcf_zenoh.analysis.one_off import try_out
from dcf_zenoh.config import load
from dcf_zenoh.errors import ConfigurationError, PlantError, PluginError
from tests.support.command_line import Answer

SLOPE = """
from dcf_zenoh.problems.problem import ConsensusProblem


class Slope(ConsensusProblem):
    size = 1

    def __init__(self, *, centre: float = 0.0):
        if centre > 5:
            raise ValueError("centre must be at most 5")
        self.centre = centre

    def gradient(self, x):
        return x - self.centre
"""
FLEET = """
name = "slope"
problem = { kind = "./slope.py:Slope" }
algorithm = { kind = "ALGORITHM" }
exchange = { threshold = 1e-8, max_rounds = 2000 }
topology = { kind = "ring" }
agents.1.problem.centre = 1.0
agents.2.problem.centre = 2.0
agents.3.problem.centre = CENTRE
"""
PLANT = """
from dcf_zenoh.plant import Plant


class Listed(Plant):
    def __init__(self, start):
        self.at = start

    def sense(self, now):
        return [*self.at, 0.0, 0.0]

    def act(self, setpoint, now):
        pass
"""


def written(folder: Path, algorithm: str, centre: float) -> Path:
    (folder / "slope.py").write_text(SLOPE)
    fleet = folder / "fleet.toml"
    fleet.write_text(FLEET.replace("ALGORITHM", algorithm).replace("CENTRE", str(centre)))
    return fleet


def test_a_problem_needs_no_method_that_its_algorithm_never_calls(tmp_path: Path) -> None:
    run = dcf_zenoh.simulate(written(tmp_path, "gradient_tracking", 3.0))
    assert run.agents[1].decision[0][0] == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize(
    ("algorithm", "centre", "error", "text"),
    [
        ("edge_admm", 3.0, ConfigurationError, r"edge_admm calls argmin\(\), which .*Slope has not"),
        ("gradient_tracking", 9.0, PluginError, "centre must be at most 5"),
    ],
)
def test_check_load_refuses_what_simulate_refuses(
    algorithm: str,
    centre: float,
    error: type[Exception],
    text: str,
    tmp_path: Path,
    agentd: Callable[..., Answer],
) -> None:
    fleet = written(tmp_path, algorithm, centre)
    with pytest.raises(error, match=text):
        dcf_zenoh.simulate(fleet)
    with pytest.raises(error, match=text):
        try_out(load(fleet))
    assert agentd("check", fleet, "--load").code != 0
    assert agentd("check", fleet).code == 0


def test_check_load_passes_what_flies(agentd: Callable[..., Answer]) -> None:
    for fleet in ("position_swap", "quadratic"):
        assert agentd("check", fleet, "--load").code == 0


def test_a_plant_that_returns_a_list_is_told_at_the_first_step(tmp_path: Path) -> None:
    (tmp_path / "listed.py").write_text(PLANT)
    changes = [f"plants.p.kind={tmp_path / 'listed.py'}:Listed"]
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(
        'name = "l"\ntime = { sample_time = 0.2, duration = 1.0 }\nproblem = { kind = "position_swap" }\n'
        'algorithm = { kind = "trades" }\nplants.p.kind = "point_mass"\n'
        "agents.1 = { start = [0.0, 0.0], target = [2.0, 0.0] }\n"
        "agents.2 = { start = [2.0, 0.0], target = [0.0, 0.0] }\n"
    )
    with pytest.raises(PlantError, match=r"step 0: sense returned a list; expected State\(position, velocity\)"):
        dcf_zenoh.simulate(fleet, changes=changes)
