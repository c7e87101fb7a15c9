"""``agentd preflight``: the bodies of a fleet, inspected before a flight."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.bodies import Sandbox
from tests.support.command_line import Answer


@pytest.fixture
def sandbox(tmp_path: Path) -> Sandbox:
    found = Sandbox(tmp_path)
    found.write(duration=1.0)
    return found


def test_checks_of_each_body_are_printed_and_nothing_moves(sandbox: Sandbox, agentd: Callable[..., Answer]) -> None:
    answer = agentd("preflight", sandbox.file, "--set", "plants.body.pauses=2")
    assert (answer.code, answer.err) == (0, "")
    rows = [line.split() for line in answer.out.splitlines() if line.strip()[:1].isdigit()]
    assert rows == [[str(agent), "3.92", "V", "1", "deg", "ready"] for agent in (1, 2, 3)]
    for agent in (1, 2, 3):
        assert sandbox.of(agent) == ["prepare", "inspect", "close"]


def test_bodies_are_inspected_at_the_same_time(sandbox: Sandbox, agentd: Callable[..., Answer]) -> None:
    agentd("preflight", sandbox.file, "--set", "plants.body.pauses=2")
    order = [what for _, what in sandbox.entries]
    assert order.index("inspect") > max(i for i, what in enumerate(order) if what == "prepare")


def test_problem_of_one_body_is_named_and_the_others_are_still_reported(
    sandbox: Sandbox, agentd: Callable[..., Answer]
) -> None:
    answer = agentd("preflight", sandbox.file, "--set", "agents.2.plants.body.fails=checks")
    assert answer.code == 1
    assert answer.err == "agentd: agent 2: battery 3.92 V: at least 3.5 V is needed\n"
    verdicts = [line.strip().split("  ")[-1].strip() for line in answer.out.splitlines() if line.strip()[:1].isdigit()]
    assert verdicts == ["ready", "not ready", "ready"]
    assert "3.92 V !" in answer.out


def test_body_that_cannot_be_reached_is_named(sandbox: Sandbox, agentd: Callable[..., Answer]) -> None:
    answer = agentd("preflight", sandbox.file, "--set", "agents.3.plants.body.fails=prepare")
    assert answer.code == 1
    assert answer.err.startswith("agentd: agent 3: prepare: RuntimeError: no (body.py:")
    assert sandbox.of(3) == ["prepare", "close"]


def test_simulated_bodies_have_no_checks(agentd: Callable[..., Answer]) -> None:
    answer = agentd("preflight", "position_swap")
    assert answer.code == 0
    assert answer.out.count("simulated: nothing to look at") == 4
