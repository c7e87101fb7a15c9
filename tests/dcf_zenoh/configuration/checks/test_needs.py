"""What an algorithm needs and does not find is said by the checks of a fleet file, under the key to be changed."""

from pathlib import Path

import pytest

import agentd.fleets
from dcf_zenoh.config import Overrides, load
from tests.support.fleet_files import problems

BUILT_IN = Path(agentd.fleets.__file__).parent
SQUARES = """
name = "squares"
[topology]
kind = "ring"
[problem]
kind = "quadratic"
[algorithm]
kind = "extra"
[agents]
1.problem.centre = 1.0
2.problem.centre = 2.0
3.problem.centre = 6.0
"""


CENTRES = [f"agents.{i}.problem.centre={i}.0" for i in (1, 2, 3)]


@pytest.fixture
def squares(tmp_path: Path) -> Path:
    path = tmp_path / "squares.toml"
    path.write_text(SQUARES)
    return path


def test_an_algorithm_of_another_structure_is_refused_and_others_are_named(squares: Path) -> None:
    assert problems(squares, algorithm="dual_subgradient") == [
        "algorithm.kind: dual_subgradient solves a problem with shared constraints, and quadratic is a consensus"
        " problem; those that can solve it: admm_tracking_gradient, centralised, consensus_admm, dual_decomposition,"
        " edge_admm, exact_diffusion, extra, gradient_tracking, push_pull, subgradient"
    ]


def test_what_a_problem_poses_in_each_step_counts() -> None:
    assert problems(BUILT_IN / "position_swap.toml", algorithm="extra") == [
        "algorithm.kind: extra solves a consensus problem, and position_swap is an aggregative game with shared"
        " constraints; those that can solve it: admm_mpc, centralised, trades, trades_robust"
    ]


def test_a_cost_with_a_kink_needs_a_method_without_gradients(squares: Path) -> None:
    changes = ["problem.kind=absolute_value", *(f"agents.{i}.problem={{value={i}.0}}" for i in (1, 2, 3))]
    assert problems(squares, *changes) == [
        "algorithm.kind: extra needs a cost with a gradient everywhere, which absolute_value has not; those that can"
        " solve it: centralised, consensus_admm, edge_admm, subgradient"
    ]


def test_what_depends_on_numbers_is_found_too() -> None:
    assert problems(BUILT_IN / "quadratic.toml", "agents.3.problem.upper=0.5") == [
        "algorithm.kind: gradient_tracking needs a decision without bounds, which quadratic has not; those that can"
        " solve it: centralised, consensus_admm, dual_decomposition, edge_admm, subgradient"
    ]
    assert problems(BUILT_IN / "cournot.toml", algorithm="trades_primal") == [
        "algorithm.kind: trades_primal needs a game without shared constraints, which cournot has not; those that can"
        " solve it: admm_mpc, centralised, trades, trades_robust"
    ]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            ["topology.directed=true"],
            "topology: extra needs links in both directions; agent 1 hears [3] and is heard by [2] (use an undirected"
            " topology)",
        ),
        (
            ["topology.kind=star", "topology.weights=uniform"],
            "topology.weights: extra needs doubly stochastic weights; these are not (use an undirected topology with"
            " weights = 'metropolis')",
        ),
        (
            ["topology.weights=laplacian", "topology.weight_step=0.5"],
            "topology.weights: weight_step must be less than 1 / 2, as there is an agent with 2 neighbours, not 0.5",
        ),
        (["algorithm.step=0"], "algorithm.step: expected a number > 0, not 0"),
        (
            ["algorithm.kind=edge_admm", "algorithm.relax=1.5"],
            "algorithm.relax: expected a number > 0 <= 1, not 1.5",
        ),
    ],
)
def test_links_weights_and_options_are_checked(squares: Path, changes: list[str], text: str) -> None:
    assert problems(squares, *changes) == [text]


def test_a_game_in_which_all_actions_must_be_seen_needs_the_complete_graph(squares: Path) -> None:
    changes = ["problem.kind=cournot", *(f"agents.{i}.problem={{cost={i}.0}}" for i in (1, 2, 3))]
    assert problems(squares, *changes, algorithm="pseudo_gradient", topology="path") == [
        "topology: pseudo_gradient needs every agent to hear all others; agent 1 hears [2] of 2 (use topology"
        " 'complete')"
    ]
    load(squares, Overrides(algorithm="pseudo_gradient"), changes=changes)  # three on a ring all hear each other


def test_too_few_agents_are_refused(tmp_path: Path) -> None:
    alone = tmp_path / "alone.toml"
    alone.write_text(SQUARES.replace("2.problem.centre = 2.0\n3.problem.centre = 6.0\n", ""))
    assert problems(alone, algorithm="edge_admm") == ["topology: edge_admm needs at least 2 agents, not 1"]


def test_positions_and_plants_go_together(squares: Path) -> None:
    changes = ["problem.kind=rendezvous", "agents.1.problem={}", "agents.2.problem={}", "agents.3.problem={}"]
    assert problems(squares, *changes) == [
        "problem.kind: rendezvous is posed anew at every step, from where the agents are: they need plants"
    ]
    bodies = ["plants.point.kind=point_mass", *(f"agents.{i}.start=[{i}.0,0.0]" for i in (1, 2, 3))]
    assert problems(squares, *bodies) == [
        "problem.kind: quadratic does not depend on where the agents are: leave out their plants"
    ]
    load(squares, changes=[*changes, *bodies])


MINE = """
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import CoupledProblem

def free(problem, me):
    yield

@needs(CoupledProblem, links="complete")
def choosy(problem, me):
    yield

class Odd:
    def __init__(self, *, centre: float):
        pass
"""


def test_one_s_own_algorithms_are_restricted_by_what_they_say_alone(squares: Path) -> None:
    (squares.parent / "mine.py").write_text(MINE)
    load(squares, Overrides(algorithm=f"{squares.parent}/mine.py:free"), changes=["topology.directed=true"])
    assert problems(squares, algorithm=f"{squares.parent}/mine.py:choosy", topology="path")[0] == (
        "topology: choosy needs every agent to hear all others; agent 1 hears [2] of 2 (use topology 'complete')"
    )


def test_third_party_problems_are_recognised_by_their_methods(squares: Path) -> None:
    (squares.parent / "mine.py").write_text(MINE)
    (text,) = problems(squares, f"problem.kind={squares.parent}/mine.py:Odd", *CENTRES)
    assert text.startswith("algorithm.kind: extra solves a consensus problem, and ")
    assert text.endswith("mine.py:Odd has no gradient")


def test_third_party_code_does_not_run_where_it_must_not(squares: Path) -> None:
    (squares.parent / "mine.py").write_text(MINE)
    load(squares, changes=[f"problem.kind={squares.parent}/mine.py:Odd", *CENTRES], run_plugins=False)
    load(squares, changes=[f"algorithm.kind={squares.parent}/mine.py:choosy"], run_plugins=False)
