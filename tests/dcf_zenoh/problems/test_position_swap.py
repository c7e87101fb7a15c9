import numpy as np
import osqp
import pytest
from scipy import sparse

from dcf_zenoh.problems.position_swap import PositionSwap
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
    ("option", "value", "message"),
    [
        ("horizon", 0, "horizon must be positive"),
        ("radii", (0.5, -1.0), "radii must be positive"),
        ("barrier_decay", 1.5, r"barrier_decay must be in \(0, 1\], not 1.5"),
        ("state_weight", (1.0, 2.0), "state_weight must be a number >= 0 or 4 of them"),
        ("target", (1.0,), r"target must be \[x, y\] in m"),
    ],
)
def test_options_out_of_range_are_refused(option: str, value: object, message: str) -> None:
    options = {"target": (0.0, 0.0), option: value}
    with pytest.raises(ValueError, match=message):
        PositionSwap(1, (1, 2), 0.2, **options)  # type: ignore[arg-type]
