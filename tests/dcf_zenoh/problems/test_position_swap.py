from collections.abc import Callable

import numpy as np
import osqp
import pytest
from scipy import sparse

from dcf_zenoh.config import load
from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.plugins import accepted
from dcf_zenoh.problems.distance_swap import DistanceSwap
from dcf_zenoh.problems.position_swap import PositionSwap
from dcf_zenoh.problems.shared.swap_options import BarrierOptions, CostOptions, DiamondOptions, PredictionOptions
from tests.support.references import INSTANCES, Reference

EXACT = 1e-12


@pytest.mark.parametrize("name", INSTANCES)
def test_the_game_equals_the_reference(name: str) -> None:
    reference = Reference.read(name)
    for i, game in reference.games.items():
        problem = reference.problem(i)
        np.testing.assert_allclose(problem.quadratic, reference.data["M"], atol=EXACT)
        np.testing.assert_allclose(problem.end_map, reference.data["Phi"], atol=EXACT)
        np.testing.assert_allclose(problem.row_scale, reference.data["row_scale"], rtol=EXACT)
        np.testing.assert_allclose(game.A, reference.expected("A_i", i), atol=1e-11)
        np.testing.assert_allclose(game.b, reference.expected("b_i", i), atol=1e-11)
        np.testing.assert_allclose(game.contribution(np.zeros(6)), reference.expected("phi_offset", i), atol=EXACT)


@pytest.mark.parametrize("name", ["n4_complete_start", "n4_line_agg", "n4_star_boxactive"])
def test_an_independent_solver_finds_the_equilibrium_of_the_potential(name: str) -> None:
    # With equal weights the game has the potential sum_i f_i + (p_a / N) |sigma - p_o|^2.
    reference = Reference.read(name)
    games, problems = reference.games, {i: reference.problem(i) for i in reference.agents}
    count = len(games)
    weight = reference.data["p_a"][0] / count
    end = np.hstack([problems[i].end_map for i in games]) / count
    offset = sum(games[i].contribution(np.zeros(6)) for i in games) / count - np.array(reference.data["p_o"])
    quadratic = sparse.block_diag([2 * problems[i].quadratic for i in games]) + 2 * weight * end.T @ end
    linear = np.concatenate([2 * np.array(reference.data["g"][i]) for i in games]) + 2 * weight * end.T @ offset
    rows = np.hstack([games[i].A for i in games])
    bound = np.full(6 * count, 2.0)
    solver = osqp.OSQP()
    solver.setup(
        sparse.triu(quadratic, format="csc"),
        linear,
        sparse.csc_matrix(np.vstack((rows, np.eye(6 * count)))),
        np.concatenate((np.full(len(rows), -np.inf), -bound)),
        np.concatenate((sum(game.b for game in games.values()), bound)),
        eps_abs=1e-9,
        eps_rel=1e-9,
        max_iter=100_000,
        verbose=False,
    )
    solution = solver.solve(raise_error=True).x.reshape(count, 6)
    np.testing.assert_allclose(solution, reference.data["u_star"], atol=1e-6)


def test_both_agents_of_a_pair_share_opposite_rows() -> None:
    games = Reference.read("n4_line_agg").games
    for i, j in ((0, 1), (1, 3)):
        pair = Reference.read("n4_line_agg").data["pairs"].index([i, j])
        rows = slice(3 * pair, 3 * pair + 3)
        np.testing.assert_allclose(games[i].A[rows], -games[j].A[rows])


def test_equal_positions_count_as_greater_for_the_lower_id() -> None:
    states = {1: np.array([0.0, 1.0, 0, 0]), 2: np.array([1e-12, -1.0, 0, 0])}
    game = PositionSwap(1, (1, 2), 0.2, target=(0.0, -1.0)).at(states)
    away = PositionSwap(2, (1, 2), 0.2, target=(0.0, 1.0)).at(states)
    assert (game.A[2, ::2] <= 0).all()  # accelerating to +x helps agent 1 ...
    assert (away.A[2, ::2] >= 0).all()  # ... and to -x agent 2


def test_the_barrier_rows_hold_exactly_when_the_barrier_condition_does() -> None:
    # Independent evaluation: simulate both double integrators and test w . delta on the trajectory.
    rng = np.random.default_rng(1)
    problems = {i: PositionSwap(i, (1, 2), 0.2, target=(0.0, 0.0)) for i in (1, 2)}
    for _ in range(50):
        states = {i: rng.normal(size=4) for i in (1, 2)}
        inputs = {i: rng.normal(size=(3, 2)) for i in (1, 2)}
        paths = {}
        for i in (1, 2):
            position, velocity = states[i][:2], states[i][2:]
            paths[i] = [position]
            for a in inputs[i]:
                position = position + 0.2 * velocity + 0.02 * a
                velocity = velocity + 0.2 * a
                paths[i].append(position)
        signs = np.sign(states[1][:2] - states[2][:2])
        h = [signs @ ((p - q) / [0.5, 0.25]) - 1 for p, q in zip(paths[1], paths[2], strict=True)]
        margin = sum(problems[i].at(states).coupling(inputs[i].ravel()) for i in (1, 2)) / problems[1].row_scale
        np.testing.assert_allclose(margin, [-(h[step + 1] - 0.9 * h[step]) for step in range(3)], atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PredictionOptions(horizon=0), "horizon must be positive, not 0"),
        (lambda: PredictionOptions(accel_max=-1.0), r"accel_max must be positive, not -1\.0"),
        (lambda: DiamondOptions(radii=(0.5, -1.0)), r"radii must be positive, not -1\.0"),
        (lambda: BarrierOptions(decay=1.5), r"decay must be in \(0, 1\], not 1\.5"),
        (lambda: CostOptions(state=(1.0, 2.0)), "state must be a number >= 0 or 4 of them"),
        (lambda: CostOptions(input=-1.0), r"input must be a number >= 0 or 2 of them, not -1\.0"),
        (lambda: PositionSwap(1, (1, 2), 0.2, target=(1.0,)), r"target must be \[x, y\] in m"),
    ],
)
def test_options_out_of_range_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("fleet", ["position_swap", "distance_swap"])
def test_keys_of_earlier_versions_are_refused_with_their_name_now(fleet: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        load(fleet, changes=["problem.radii=[0.5, 0.5]", "problem.horizon=4", "agents.2.problem.gather_weight=2.0"])
    kind = {"position_swap": "PositionSwap", "distance_swap": "DistanceSwap"}[fleet]
    assert sorted(refused.value.problems) == [
        f"agents.2.problem.gather_weight: {kind} has no key 'gather_weight' any more: it is called 'cost.gather'",
        f"problem.horizon: {kind} has no key 'horizon' any more: it is called 'prediction.horizon'",
        f"problem.radii: {kind} has no key 'radii' any more: it is called 'barrier.radii'",
    ]


def test_every_key_of_earlier_versions_has_a_name_now() -> None:
    for kind in (PositionSwap, DistanceSwap):
        keys = {f"{table.name}.{key.name}" for table in accepted(kind).parameters if table.table
                for key in table.table.parameters}  # fmt: skip
        assert set(kind.RENAMED.values()) == keys


def test_both_swaps_have_the_same_defaults() -> None:
    swap, true_distance = (load(name).spec.problem.options for name in ("position_swap", "distance_swap"))
    assert swap["prediction"] == true_distance["prediction"]
    assert swap["cost"] == true_distance["cost"]
    assert swap["barrier"] == {**true_distance["barrier"], "margin": 0.0, "obstacles": []}
