"""A horizon in which nobody can brake is noted in simulations, and refused where real bodies fly."""

import re

import pytest

from dcf_zenoh.config import Overrides, load
from dcf_zenoh.errors import ConfigurationError

KEY = "problem.prediction.horizon"
SHORT = (
    rf"^{KEY}: 3 samples of 0\.02 s are 0\.06 s; agent \d, which flies up to 1 m/s alone and half of that among others,"
    r" brakes at 2 m/s² in 0\.25 s, and its plans show a conflict too late: expected a horizon of at least 13$"
)


def sampled(time: float, horizon: int) -> list[str]:
    """Changes to a fleet."""
    return [f"time.sample_time={time}", f"exchange.budget={time}", f"{KEY}={horizon}"]


def notes(*changes: str, source: str = "position_swap") -> list[str]:
    """What loading notes about the horizon."""
    return [note for note in load(source, Overrides(), changes=changes).notes if note.startswith(KEY)]


def test_horizon_shorter_than_braking_is_noted_with_one_that_works() -> None:
    (note,) = notes(*sampled(0.02, 3))
    assert re.match(SHORT, note)


@pytest.mark.parametrize(("time", "horizon"), [(0.02, 13), (0.05, 6), (0.1, 3), (0.2, 3), (0.5, 3)])
def test_horizon_in_which_agents_can_brake_is_not(time: float, horizon: int) -> None:
    assert notes(*sampled(time, horizon)) == []


@pytest.mark.parametrize(("time", "horizon"), [(0.02, 12), (0.05, 5), (0.1, 2)])
def test_horizon_of_one_sample_less_is(time: float, horizon: int) -> None:
    assert len(notes(*sampled(time, horizon))) == 1


@pytest.mark.parametrize(
    "source",
    ["position_swap_async", "position_swap_mixed", "position_swap_obstacles", "position_swap_ten", "rendezvous"],
)
def test_other_built_in_fleets_can_brake(source: str) -> None:
    assert notes(source=source) == []


def test_real_bodies_are_refused() -> None:
    changes = [*sampled(0.02, 3), "plants.hardware.flight.reference='planned'"]
    with pytest.raises(ConfigurationError) as refused:
        load("position_swap", Overrides(plant="hardware", clock="wall"), changes=changes)
    (problem,) = refused.value.problems
    assert re.match(SHORT, problem)


def test_bounds_matter_too() -> None:
    (note,) = notes("problem.prediction.accel_max=0.3")
    assert "brakes at 0.3 m/s² in 1" in note
