"""Agents that differ in bounds, weights and model still play one game, and find its equilibrium."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import osqp
import pytest
import tomli_w
from scipy import sparse
from scipy.optimize import lsq_linear

import dcf_zenoh
from dcf_zenoh.algorithms.trades import trades
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.position_swap import PositionSwap, SwapGame
from dcf_zenoh.problems.shared.swap_options import CostOptions, PredictionOptions
from dcf_zenoh.testing import fleet_of, lockstep
from topologies.complete import complete
from topologies.path import path

AGENTS = (1, 2, 3, 4)
STARTS = {1: (0.08, 0.55), 2: (-0.03, -0.49), 3: (0.84, 0.0), 4: (-0.7, -0.01)}
VELOCITIES = {1: (-0.19, -0.46), 2: (-0.09, 0.35), 3: (-0.33, 0.08), 4: (0.25, -0.01)}
COMMON: dict[str, Any] = {"input": 3.0, "gather": 2.0, "gather_at": (0.3, -0.2)}  # of the cost
NOMINAL = {"prediction": PredictionOptions(), "cost": CostOptions(**COMMON)}
PREDICTION: dict[int, dict[str, Any]] = {
    1: {},
    2: {"velocity_lag": 0.0},
    3: {"accel_max": 0.8},
    4: {"accel_max": 0.5, "velocity_lag": 0.1},
}
COST: dict[int, dict[str, Any]] = {
    1: {},
    2: {"state": (5.0, 5.0, 8.0, 8.0)},
    3: {"input": 5.0, "terminal": 1.0},
    4: {"input": (2.5, 4.0)},
}
UNEQUAL = {1: {"gather": 0.5}, 4: {"gather": 5.0}}


def problems(more: Mapping[int, Mapping[str, Any]] = MappingProxyType({})) -> dict[int, PositionSwap]:
    """The four agents, bound for the opposite side."""
    return {
        i: PositionSwap(
            i,
            AGENTS,
            0.2,
            NOMINAL,
            target=(-STARTS[i][0], -STARTS[i][1]),
            prediction=PredictionOptions(**PREDICTION[i]),
            cost=CostOptions(**{**COMMON, **COST[i], **more.get(i, {})}),
        )
        for i in AGENTS
    }


def posed(problems: Mapping[int, PositionSwap]) -> dict[int, SwapGame]:
    states = {i: np.array([*STARTS[i], *VELOCITIES[i]]) for i in AGENTS}
    return {i: problem.at(states) for i, problem in problems.items()}


def bounds(problems: Mapping[int, PositionSwap]) -> Array:
    return np.concatenate([np.full(6, problem.accel_max) for problem in problems.values()])


def minimiser_of_the_potential(problems: Mapping[int, PositionSwap]) -> Array:
    """argmin sum_i f_i + (p_a / N) |sigma - p_o|² under all constraints, by OSQP; p_a must be one for all."""
    games, count = posed(problems), len(problems)
    weight = COMMON["gather"] / count
    end = np.hstack([problem.end_map for problem in problems.values()]) / count
    offset = sum(game.contribution(np.zeros(6)) for game in games.values()) / count - np.array(COMMON["gather_at"])
    quadratic = sparse.block_diag([2 * each.quadratic for each in problems.values()]) + 2 * weight * end.T @ end
    slopes = [
        2 * problem.linear @ np.array([2 * STARTS[i][0], 2 * STARTS[i][1], *VELOCITIES[i]])
        for i, problem in problems.items()
    ]
    bound = bounds(problems)
    solver = osqp.OSQP()
    solver.setup(
        sparse.triu(quadratic, format="csc"),
        np.concatenate(slopes) + 2 * weight * end.T @ offset,
        sparse.csc_matrix(np.vstack((np.hstack([game.A for game in games.values()]), np.eye(len(bound))))),
        np.concatenate((np.full(games[1].rows, -np.inf), -bound)),
        np.concatenate((sum(game.b for game in games.values()), bound)),
        eps_abs=1e-10,
        eps_rel=1e-10,
        max_iter=200_000,
        verbose=False,
    )
    solution: Array = solver.solve(raise_error=True).x
    return solution


def distributed(problems: Mapping[int, PositionSwap], topology: Any) -> Array:
    results = lockstep(trades, posed(problems), fleet_of(Graph.of(AGENTS, topology(AGENTS))), 4000)
    return np.concatenate([results[i].decision for i in AGENTS])


def test_the_rows_have_one_scale_whatever_the_agents_are() -> None:
    scales = [problem.row_scale for problem in problems().values()]
    nominal = PositionSwap(9, AGENTS, 0.2, target=(0.0, 0.0), cost=CostOptions(**COMMON)).row_scale
    for scale in scales:
        np.testing.assert_array_equal(scale, nominal)
    cost = CostOptions(**{**COMMON, **COST[3]})
    alone = PositionSwap(3, AGENTS, 0.2, target=(0.0, 0.0), cost=cost).row_scale
    assert abs(alone - nominal).min() > 0.5  # which is what an agent by itself would have taken


@pytest.mark.parametrize("topology", [complete, path])
def test_with_one_gather_weight_the_equilibrium_is_that_of_the_potential(topology: Any) -> None:
    fleet = problems()
    expected = minimiser_of_the_potential(fleet)
    games = posed(fleet).values()
    rows = np.asarray(sum(game.coupling(u) for game, u in zip(games, expected.reshape(4, 6), strict=True)))
    assert (rows > -1e-6).sum() >= 3  # some barriers are in the way,
    assert (abs(expected) > bounds(fleet) - 1e-6).sum() >= 3  # and some bounds
    np.testing.assert_allclose(distributed(fleet, topology), expected, atol=1e-6)


def test_with_several_gather_weights_the_equilibrium_has_one_multiplier_for_all() -> None:
    fleet = problems(UNEQUAL)
    decisions = distributed(fleet, complete)
    games, bound = posed(fleet), bounds(fleet)
    own = dict(zip(AGENTS, decisions.reshape(4, 6), strict=True))
    sigma = sum(games[i].contribution(u) for i, u in own.items()) / 4
    force = np.concatenate([games[i].gradient(u, np.asarray(sigma)) for i, u in own.items()])
    rows = np.asarray(sum(games[i].coupling(u) for i, u in own.items()))
    assert rows.max() <= 1e-6
    assert (abs(decisions) <= bound + 1e-9).all()
    # force + A' lambda + (upper - lower) = 0, with multipliers >= 0 of what is active.
    active = np.hstack([games[i].A for i in AGENTS])[rows > -1e-6].T
    eye = np.eye(len(decisions))
    walls = np.hstack((eye[:, decisions > bound - 1e-7], -eye[:, decisions < 1e-7 - bound]))
    fit = lsq_linear(np.hstack((active, walls)), -force, bounds=(0, np.inf), tol=1e-12)
    assert len(active.T) >= 3
    assert abs(fit.fun).max() < 1e-5
    assert abs(decisions - distributed(problems(), complete)).max() > 1e-4  # the weights do matter


def test_the_keys_of_the_problem_are_the_nominal_ones_in_a_fleet_file(tmp_path: Path) -> None:
    own = {i: {"prediction": PREDICTION[i], "cost": COST[i]} for i in AGENTS}
    fleet = {
        "name": "one_step",
        "plant": "point",
        "time": {"clock": "virtual", "sample_time": 0.2, "duration": 0.2},
        "exchange": {"max_rounds": 4000, "threshold": 1e-11},
        "problem": {"kind": "position_swap", "cost": COMMON},
        "algorithm": {"kind": "trades"},
        "plants": {"point": {"kind": "point_mass"}},
        "agents": {
            str(i): {
                "start": list(STARTS[i]),
                "target": [-STARTS[i][0], -STARTS[i][1]],
                "problem": own[i],
                "plants": {"point": {"velocity": list(VELOCITIES[i])}},
            }
            for i in AGENTS
        },
    }
    file = tmp_path / "one_step.toml"
    file.write_text(tomli_w.dumps(fleet))
    run = dcf_zenoh.simulate(file)
    decisions = np.concatenate([run.agents[i].decision[0] for i in AGENTS])
    np.testing.assert_allclose(decisions, minimiser_of_the_potential(problems()), atol=1e-6)


def test_a_body_with_a_lag_is_told_the_velocity_that_its_model_assumes() -> None:
    # A body that is told v + a t_s and lags behind it is where the plan says after every stage.
    problem = problems()[4]
    state = np.array([*STARTS[4], *VELOCITIES[4]])
    decision = np.array([0.3, -0.2, 0.1, 0.4, -0.5, 0.2])
    game = posed(problems())[4]
    position, velocity = state[:2], state[2:]
    left = np.exp(-0.2 / 0.1)
    for stage in range(3):
        setpoint = game.setpoint(decision, stage)
        assert setpoint is not None
        np.testing.assert_allclose(setpoint.velocity, velocity + 0.2 * decision[2 * stage : 2 * stage + 2])
        apart = velocity - setpoint.velocity
        position = position + 0.2 * setpoint.velocity + apart * 0.1 * (1 - left)
        velocity = setpoint.velocity + apart * left
        np.testing.assert_allclose(setpoint.position, position)
    assert game.setpoint(decision, 3) is None
    assert problem.velocity_lag == 0.1
