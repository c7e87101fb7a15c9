from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from dcf_zenoh.analysis.motion import BodyMotion, below_zero, course
from dcf_zenoh.plant import Array, KnownPath, Piece, Setpoint
from plants.point_mass import PointMass
from plants.single_integrator import SingleIntegrator
from plants.unicycle import Unicycle

S = 1_000_000_000  # ns


def distance(one: Array, other: Array) -> Array:
    gaps: Array = np.linalg.norm(one - other, axis=1)
    return gaps


def diamond(one: Array, other: Array) -> Array:
    h: Array = abs(one - other) @ np.array([1 / 0.5, 1 / 0.25]) - 1
    return h


def parabolas(seed: int) -> tuple[BodyMotion, BodyMotion]:
    """Two bodies, each with four pieces of constant acceleration that meet in position and velocity."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(2):
        begin = np.array([0.0, 0.2, 0.4, 0.6])
        terms = np.zeros((4, 3, 2))
        position, velocity = rng.normal(size=2), rng.normal(size=2)
        for piece in terms:
            acceleration = rng.uniform(-2, 2, size=2)
            piece[:] = position, velocity, acceleration
            position = position + velocity * 0.2 + acceleration * 0.02
            velocity = velocity + acceleration * 0.2
        found.append(BodyMotion(begin, terms, known=True))
    return found[0], found[1]


@pytest.mark.parametrize("measure", [distance, diamond])
@pytest.mark.parametrize("seed", range(8))
def test_the_least_value_is_that_of_a_search_over_the_whole_time(measure: object, seed: int) -> None:
    assert callable(measure)
    one, other = parabolas(seed)

    def value(time: float) -> float:
        at = np.array([time])
        return float(measure(one.at(at), other.at(at))[0])

    times = np.linspace(0.0, 0.8, 801)
    values = measure(one.at(times), other.at(times))
    near = np.flatnonzero(values < values.min() + 2e-3).clip(1, 799)
    least = min(
        minimize_scalar(value, bounds=times[[i - 1, i + 1]], method="bounded", options={"xatol": 1e-11}).fun
        for i in near
    )
    least = min(least, float(values.min()))
    found = course(one, other, measure, np.array([0.0, 0.2, 0.4, 0.6, 0.8]))
    assert least - 1e-6 <= found.values.min() <= least + 1e-9  # the search stops short of a kink


def test_a_violation_begins_and_ends_where_the_value_is_zero() -> None:
    passing = BodyMotion(np.zeros(1), np.array([[[-1.0, 0.1], [2.0, 0.0], [0.0, 0.0]]]), known=True)
    way = course(passing, BodyMotion.resting(np.zeros(2)), diamond, np.linspace(0.0, 1.0, 6))
    ((since, duration, least),) = below_zero(way)
    half = 0.5 * (1 - 0.1 / 0.25) / 2.0  # |x| / 0.5 + 0.1 / 0.25 = 1, at 2 m/s
    assert (since, duration) == pytest.approx((0.5 - half, 2 * half), abs=1e-9)
    assert least == pytest.approx(0.1 / 0.25 - 1, abs=1e-12)


@pytest.mark.parametrize("kind", [PointMass, SingleIntegrator, Unicycle])
def test_the_pieces_of_a_path_are_where_the_body_is(kind: Any) -> None:
    body, often = kind(np.array([0.1, -0.2])), kind(np.array([0.1, -0.2]))
    assert issubclass(kind, KnownPath)
    commands = [
        (0, np.array([0.3, 0.5])),
        (S // 5, np.array([-0.1, 0.7])),
        (S // 2, None),  # comes to rest
        (S, np.array([-1.0, 0.0])),
    ]
    pieces: list[Piece] = []
    for at, acceleration in commands:
        setpoint = Setpoint(np.zeros(2), np.array([0.05, -0.03]), acceleration)
        pieces += body.path(at)
        body.act(setpoint, at)
    pieces += body.path(2 * S)
    terms = np.array([each[1:] for each in pieces])
    motion = BodyMotion(np.array([each.begin * 1e-9 for each in pieces]), terms, known=True)
    instants = range(0, 2 * S, S // 99)
    pending = list(commands)
    for now in instants:
        while pending and pending[0][0] <= now:
            at, acceleration = pending.pop(0)
            often.act(Setpoint(np.zeros(2), np.array([0.05, -0.03]), acceleration), at)
        position = motion.at(np.array([now * 1e-9]))[0]
        np.testing.assert_allclose(position, often.sense(now).position, atol=1e-6)
