"""Detours out of a knot."""

import math
from itertools import groupby

import numpy as np
import pytest

import dcf_zenoh
from dcf_zenoh.controllers.detour import Detour
from dcf_zenoh.plant import Array

SAMPLE_TIME = 0.2
TARGET = np.array([2.0, 0.0])
HERE = np.array([0.0, 0.0, 0.0, 0.0])


def directions(detour: Detour, states: list[Array]) -> list[float]:
    """Angle of each aim from the way to the target, degrees."""
    aims = [detour.aim(state) - state[:2] for state in states]
    ways = [TARGET - state[:2] for state in states]
    return [
        round(math.degrees(math.remainder(math.atan2(*aim[::-1]) - math.atan2(*way[::-1]), 2 * math.pi)))
        for aim, way in zip(aims, ways, strict=True)
    ]


def test_an_agent_that_stays_where_it_is_turns_left_left_and_right() -> None:
    found = directions(Detour(TARGET, SAMPLE_TIME), [HERE] * 80)
    assert [(angle, len(list(steps))) for angle, steps in groupby(found)][:6] == [
        (60, 20), (0, 1), (60, 20), (0, 1), (-60, 20), (0, 1)
    ]  # fmt: skip


def test_an_agent_that_comes_nearer_aims_at_its_target_after_the_first_detour() -> None:
    states = [np.array([0.02 * k, 0.0, 0.1, 0.0]) for k in range(60)]
    found = directions(Detour(TARGET, SAMPLE_TIME), states)
    assert found == [60] * 20 + [0] * 40


def test_near_its_target_no_agent_is_stuck() -> None:
    near = np.array([1.95, 0.0, 0.0, 0.0])
    detour = Detour(TARGET, SAMPLE_TIME)
    assert directions(detour, [near] * 30) == [0] * 30
    assert detour.begun == 0


@pytest.mark.parametrize(("agents", "seed"), [(4, 4), (4, 14), pytest.param(6, 5, marks=pytest.mark.large)])
def test_random_swaps_arrive(agents: int, seed: int) -> None:
    run = dcf_zenoh.simulate("position_swap_random", seed=seed, changes=[f"layout.agents={agents}"])
    assert run.arrival_time is not None
    assert run.barriers.min() >= 0
    assert run.summary()["notes"]["detours"] >= agents - 1
