"""The oracle on the command line."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

import dcf_zenoh
from dcf_zenoh.analysis.oracle import NoOracle, consult
from dcf_zenoh.records.run import Run
from tests.support.command_line import Answer

UNTOLD = """
from dcf_zenoh.problems.quadratic import Quadratic


class Untold(Quadratic):
    share = None
"""
INFEASIBLE = (
    "agentd: note: problem: there is no solution: the problem is infeasible: its constraints contradict each other\n"
)
FLEET = """
name = "untold"
problem = { kind = "./untold.py:Untold" }
algorithm = { kind = "gradient_tracking" }
topology = { kind = "ring" }
[agents]
1 = { problem = { centre = 1.0 } }
2 = { problem = { centre = 2.0 } }
3 = { problem = { centre = 4.0 } }
"""


def test_a_problem_that_cannot_be_told_has_none(tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    (tmp_path / "untold.py").write_text(UNTOLD)
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(FLEET)
    with pytest.raises(NoOracle, match="Untold has no method share"):
        consult(dcf_zenoh.simulate(fleet))
    answer = agentd("simulate", fleet, "--oracle", "--json", "--no-report", "--out", tmp_path / "out")
    assert answer.code == 0
    assert json.loads(answer.out)["oracle"] is None
    assert "note: --oracle: there is no central solution to compare with" in answer.err


def test_what_the_oracle_found_is_printed_and_drawn(tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    out = tmp_path / "out"
    options = ("--set", "time.duration=2.0", "--oracle", "--json", "--out", out)
    judged = json.loads(agentd("simulate", "position_swap", *options).out)["oracle"]
    assert judged == json.loads(json.dumps(consult(Run.read(out)).summary()))
    assert 0 < judged["plan_gap"]["max"] < 1e-2
    assert (out / "oracle.png").stat().st_size > 10_000
    (out / "oracle.png").unlink()
    answer = agentd("report", out, "--oracle")
    assert "plan to central plan" in answer.out
    assert str(out / "oracle.pdf") in answer.out
    assert (out / "oracle.png").is_file()


def test_a_problem_without_steps_is_only_told_in_numbers(tmp_path: Path, agentd: Callable[..., Answer]) -> None:
    answer = agentd("simulate", "quadratic", "--oracle", "--out", tmp_path / "out")
    assert "steps compared" in answer.out
    assert not (tmp_path / "out" / "oracle.png").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ("allocation", *(f"agents.{i}.problem.upper=1.0" for i in range(1, 5))),
            INFEASIBLE,
        ),
        (
            ("quadratic", "algorithm={kind='edge_admm'}", "agents.1.problem.lower=2.0", "agents.2.problem.upper=1.0"),
            INFEASIBLE,
        ),
        (
            ("quadratic", "exchange.threshold=1.0"),
            "agentd: note: exchange.threshold: 1 is 100% of the largest decision, 1: the agents agree before their "
            "decisions are right; try 1e-03\n",
        ),
        (("allocation",), ""),
        (("position_swap",), ""),
    ],
)
def test_check_says_that_a_problem_has_no_solution_or_is_too_small_for_the_threshold(
    words: tuple[str, ...], said: str, agentd: Callable[..., Answer]
) -> None:
    changes = [word for change in words[1:] for word in ("--set", change)]
    answer = agentd("check", words[0], *changes)
    assert answer.code == 0
    assert answer.err == said
