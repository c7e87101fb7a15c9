import re
from pathlib import Path

import pytest

import dcf_zenoh
from agentd.cli import main
from agentd.results.explanation_text import why_lines
from dcf_zenoh.analysis.explanation import explain
from tests.support.faulty_runs import named


def text(run: dcf_zenoh.Run) -> str:
    return "\n".join(why_lines(run, explain(run)))


def test_loss_is_told_with_step_pair_rounds_and_what_would_have_been(tmp_path: Path) -> None:
    run = named(tmp_path, "[faults]\nloss = 0.2\n")
    found = explain(run)
    lines = text(run).splitlines()
    i, j = found.pair
    assert lines[1] == (
        f"Closest approach: h = {found.closest.value:.3f} between agents {i} and {j} at {found.closest.time:.2f} s;"
        f" at the samples h = {found.value:.3f} at step {found.step} ({found.step * 0.2:.1f} s)."
    )
    (there,) = (line for line in lines[:8] if line.startswith(f"  {i} → {j}: "))
    assert re.search(r"\d+ of \d+ messages lost: \d+ by 'loss' \(rounds? \d", there)
    assert any(re.match(rf"  agent {i} .* after \d+ rounds, residual \S+ \(threshold 0.001\)", line) for line in lines)
    (replayed,) = (line for line in lines if line.startswith(f"  step {found.step - 1} once more ("))
    assert replayed.endswith(f"h = {found.alternatives[0].value:.3f} at step {found.step} instead of {found.value:.3f}")


def test_without_loss_the_network_is_not_the_cause(tmp_path: Path) -> None:
    run = named(tmp_path, "", "exchange.max_rounds=200")
    assert (
        text(run)
        .splitlines()[-1]
        .startswith("Nothing was lost, late or absent in these steps: the network is not the cause.")
    )


def test_runs_of_rounds_are_joined(tmp_path: Path) -> None:
    rule = '[[faults.rule]]\nodd = { kind = "./named.py:Named", lost = [[8, 3], [8, 4], [8, 5], [8, 9]] }\n'
    assert "4 by 'odd' (rounds 3–5, 9)" in text(named(tmp_path, rule))


def test_the_command_prints_it_and_errors_are_clear(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = named(tmp_path, "[faults]\nloss = 0.2\n", out=tmp_path / "run")
    assert main(["why", str(tmp_path / "run")]) == 0
    assert capfd.readouterr().out == text(run) + "\n"
    dcf_zenoh.simulate("average", out=tmp_path / "average")
    assert main(["why", str(tmp_path / "average")]) != 0
    assert capfd.readouterr().err == (
        "agentd: average: there is nothing to explain: nothing moves, as no agent has a plant\n"
    )


def test_payloads_that_were_changed_are_a_cause(tmp_path: Path) -> None:
    run = named(tmp_path, "[faults]\nnoise = 0.3\n", "exchange.max_rounds=60", "time.duration=6.0")
    lines = text(run).splitlines()
    assert "Faults of payloads: 'noise' acts on 12 links." in lines
    assert lines[-1].startswith("With a perfect network and true payloads")


def test_what_is_missing_of_a_run_is_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "run"
    dcf_zenoh.simulate("position_swap", changes=["time.duration=3.0"], out=folder)
    whole = (folder / "agent-2.msgpack").read_bytes()
    (folder / "agent-2.msgpack").write_bytes(whole[: len(whole) // 2])
    (folder / "agent-3.msgpack").unlink()
    for command in ("why", "links"):
        assert main([command, str(folder)]) == 0
        said = capfd.readouterr().err.splitlines()
        assert said[0] == "agentd: note: agent 3 has no log that can be read"
        assert re.fullmatch(r"agentd: note: agent 2's log breaks off after step \d", said[1])
