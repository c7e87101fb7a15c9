"""Notes on layouts in which a position swap is known to get stuck."""

import math

import pytest

import dcf_zenoh
from dcf_zenoh.config import load

DEADLOCK = "agents: all go straight across one circle"


def across(agents: int, radius: float, turn: float) -> list[str]:
    """Changes of a fleet file: all agents on a circle, with targets straight across."""
    angles = [turn + 2 * math.pi * k / agents for k in range(agents)]
    places = [[radius * math.cos(angle), radius * math.sin(angle)] for angle in angles]
    ways = [
        (f"agents.{i}.start={place}", f"agents.{i}.target={[-each for each in place]}")
        for i, place in enumerate(places, start=1)
    ]
    return ["agents={}", *(change for way in ways for change in way)]


@pytest.mark.parametrize(("agents", "turn"), [(4, 0.3), (4, -0.4), (4, math.pi / 2 + 0.2), (5, 0.0), (6, 0.785)])
def test_a_layout_that_gets_stuck_is_noted(agents: int, turn: float) -> None:
    changes = across(agents, 1.1, turn)
    assert any(note.startswith(DEADLOCK) for note in load("position_swap", changes=changes).notes)
    assert not load("position_swap", changes=[*changes, "controller.detour=true"]).notes


@pytest.mark.parametrize(("agents", "turn"), [(4, 0.3), pytest.param(6, 0.0, marks=pytest.mark.large)])
def test_what_is_noted_does_get_stuck_and_the_detour_leads_out(agents: int, turn: float) -> None:
    changes = [*across(agents, 1.1, turn), "time.duration=16.0", "exchange.max_rounds=60"]
    assert dcf_zenoh.simulate("position_swap", changes=changes).arrival_time is None
    detour = [*changes, "controller.detour=true", "problem.barrier.margin=0.02"]
    run = dcf_zenoh.simulate("position_swap", changes=detour)
    assert run.arrival_time is not None
    assert run.barriers.min() >= 0


@pytest.mark.parametrize("fleet", ["position_swap", "position_swap_six", "position_swap_ten", "position_swap_mixed"])
def test_layouts_that_arrive_are_not_noted(fleet: str) -> None:
    assert not [note for note in load(fleet).notes if note.startswith(DEADLOCK)]


@pytest.mark.parametrize("turn", [0.02, 0.7, 1.5])
def test_a_square_that_arrives_is_not_noted(turn: float) -> None:
    assert not load("position_swap", changes=across(4, 1.0, turn)).notes
