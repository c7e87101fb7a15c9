"""The swap with true distances: its constraints, beside closed forms."""

import numpy as np
import pytest

from dcf_zenoh.plant import Array, State
from dcf_zenoh.problems.distance_swap import ASIDE, DistanceSwap, clearance
from dcf_zenoh.problems.shared.diamond import barrier

AGENTS, RADII = (1, 2, 5), np.array([0.5, 0.25])
PLACES = {1: (0.0, 1.0), 2: (0.3, -1.0), 5: (1.0, 0.2)}


def problem(agent: int = 2, **options: object) -> DistanceSwap:
    return DistanceSwap(agent, AGENTS, 0.2, target=(0.0, 2.0), **options)  # type: ignore[arg-type]


def states(**moved: tuple[float, float]) -> dict[int, Array]:
    places = {**PLACES, **{int(name[1:]): place for name, place in moved.items()}}
    return {i: np.array([*place, 0.1 * i, -0.2]) for i, place in places.items()}


def test_outputs_are_the_predicted_path() -> None:
    game, u = problem().at(states()), np.array([1.0, -0.5, 0.3, 2.0, -1.0, 0.7])
    p, v = np.array(PLACES[2]), np.array([0.2, -0.2])
    path = []
    for a in u.reshape(3, 2):
        p, v = p + 0.2 * v + 0.02 * a, v + 0.2 * a
        path.append(p)
    np.testing.assert_allclose(game.T @ u + game.t, np.ravel(path), atol=1e-12)


def test_constraints_are_those_of_the_scaled_distance() -> None:
    outputs = np.random.default_rng(0).normal(size=(3, 6))
    c, _ = problem().at(states()).constraints(outputs)
    paths = [np.vstack((PLACES[i], row.reshape(3, 2))) for i, row in zip(AGENTS, outputs, strict=True)]
    expected = []
    for other in (0, 2):
        e = [float(np.sqrt((d[0] / 0.5) ** 2 + (d[1] / 0.25) ** 2)) - 1 for d in paths[1] - paths[other]]
        expected += [0.9 * e[stage] - e[stage + 1] for stage in range(3)]
    np.testing.assert_allclose(c, expected, atol=1e-12)


def test_both_of_a_pair_mean_the_same() -> None:
    now = states(a1=(0.305, 1.0))  # 1 and 2 in line
    outputs = np.random.default_rng(1).normal(size=(3, 6))
    first, second = (problem(agent).at(now).constraints(outputs) for agent in (1, 2))
    np.testing.assert_array_equal(first[0][:3], second[0][:3])
    np.testing.assert_array_equal(first[1][:3], second[1][:3])


def test_equal_radii_make_a_distance() -> None:
    apart = np.array([[0.3, 0.4], [0.6, 0.8], [0.0, 0.5]])
    e, _ = clearance(apart, np.array([0.5, 0.5]), np.zeros_like(apart))
    np.testing.assert_allclose(0.5 * (e + 1), [0.5, 1.0, 0.5], atol=1e-12)


def test_the_diamond_is_in_the_ellipse_and_tangents_are_below_it() -> None:
    rng = np.random.default_rng(2)
    apart = rng.normal(size=(500, 2))
    e, slope = clearance(apart, RADII, np.zeros_like(apart))
    assert all(barrier(each, tuple(RADII)) >= value - 1e-12 for each, value in zip(apart, e, strict=True))
    beside, tilted = clearance(apart, RADII, rng.normal(scale=0.2, size=apart.shape))
    assert (beside <= e + 1e-12).all()
    assert np.allclose(np.hypot(*(slope * RADII).T), 1)
    assert np.allclose(np.hypot(*(tilted * RADII).T), 1)


def test_agents_in_line_are_led_past_each_other_the_lower_id_on_the_positive_side() -> None:
    now = states(a1=(0.3, 1.0), a5=(5.0, 5.0))
    outputs = np.array([np.tile(now[i][:2], 3) for i in AGENTS])
    _, derivative = problem(1).at(now).constraints(outputs)
    towards = derivative[0, :, :2]  # of the first constraint, with regard to the first position of each
    assert towards[0, 0] < 0 < towards[1, 0]  # it is kept by moving 1 to the right, 2 to the left
    scaled = np.array([ASIDE / 0.5, 2 / 0.25])
    np.testing.assert_allclose(-towards[0], scaled / RADII / np.hypot(*scaled), atol=1e-12)
    off = states(a1=(0.32, 1.0), a5=(5.0, 5.0))
    outputs = np.array([np.tile(off[i][:2], 3) for i in AGENTS])
    _, derivative = problem(1).at(off).constraints(outputs)
    assert -derivative[0, 0, 0] == pytest.approx(0.02 / 0.25 / np.hypot(0.02 / 0.5, 2 / 0.25))


def test_starts_in_the_ellipse_are_refused() -> None:
    inside = {1: np.array([0.0, 0.0]), 2: np.array([0.35, 0.15]), 5: np.array([3.0, 3.0])}  # h > 0 > e
    assert problem().check_starts(inside) == {
        2: "agent 2 would start in the safety region of agent 1: e = -0.078, expected at least 0"
    }
    assert problem().check_starts({i: np.array(place) for i, place in PLACES.items()}) == {}


def test_it_can_be_turned_to_another_target() -> None:
    swap = problem()
    other = swap.toward(np.array([1.0, 1.0]))
    here = State(np.array([1.0, 0.0]), np.zeros(2))
    assert other.distance_to_go(here) == 1.0
    assert swap.distance_to_go(here) == pytest.approx(np.sqrt(5))
    assert not np.allclose(other.at(states()).share().g, swap.at(states()).share().g)


def test_what_is_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match=r"target must be \[x, y\] in m, not \[0\.0\]"):
        DistanceSwap(2, AGENTS, 0.2, target=(0.0,))
