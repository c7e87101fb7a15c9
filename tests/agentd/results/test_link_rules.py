from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dcf_zenoh
from agentd.results.link_rules import replay_rules
from dcf_zenoh.analysis.link_health import Crossing, LinkHealth, link_health
from dcf_zenoh.config import load
from dcf_zenoh.faults.bursts import Bursts
from dcf_zenoh.graph import Graph
from dcf_zenoh.records.log_writer import log_name
from dcf_zenoh.records.run import Run
from dcf_zenoh.spec import FaultRule
from tests.support.command_line import Answer
from tests.support.lossy_fleets import lossy

ON = 'safety.neighbour_silent={after=9.0, then="continue"}'
SHORT = ("time.duration=2.0", ON)
LONG = ("time.duration=10.0", ON)
DEAD_AND_SLOW = """
[[faults.rule]]
from = 1
to = 2
loss = 1.0

[[faults.rule]]
from = 3
to = 4
latency = 0.003
"""
ALIKE_BUT_ONE = """
[faults]
latency = 0.0005

[[faults.rule]]
from = 1
to = 2
loss = 1.0
"""
ALL_SLOW_AND_SOME_DEAD = """
[faults]
latency = { distribution = "uniform", low = 0.0002, high = 0.0008 }

[[faults.rule]]
from = 3
loss = 1.0

[[faults.rule]]
from = 1
to = 2
loss = 0.3
"""


def measured(sender: int, receiver: int, lost: str, latency: float | None = 0.001) -> LinkHealth:
    """A link over which messages came (``.``) and did not (``x``), with that latency; None: with an unknown one."""
    entered, due = (0, -1) if latency is None else (0, round(latency * 1e9))
    crossings = tuple(
        Crossing(number, 0, number, "loss", entered, -1)
        if sign == "x"
        else Crossing(number, 0, number, "", entered, due, waited=latency is None)
        for number, sign in enumerate(lost)
    )
    return LinkHealth(
        sender=sender,
        receiver=receiver,
        recorded=True,
        crossings=crossings,
        per_step=np.array([[len(lost), lost.count("x"), 0]]),
        missing=0,
        latencies=np.array([each.latency for each in crossings if each.latency is not None]),
        longest_gap=0.0,
        clock_ahead=None,
        clock_error=None,
    )


def complete(agents: int) -> Graph:
    ids = range(1, agents + 1)
    return Graph.of(ids, [(i, j) for i in ids for j in ids if i != j])


def rules(graph: Graph, *health: LinkHealth) -> list[dict[str, Any]]:
    return replay_rules(health, Path("lab.json"), graph)


@pytest.mark.parametrize(
    ("faults", "topology"),
    [
        pytest.param(DEAD_AND_SLOW, "ring", id="few, ring"),
        pytest.param(ALIKE_BUT_ONE, "complete", id="most, complete"),
        pytest.param(ALL_SLOW_AND_SOME_DEAD, "ring", id="all, ring"),
        pytest.param(DEAD_AND_SLOW, "complete", id="few, complete", marks=pytest.mark.large),
        pytest.param(ALIKE_BUT_ONE, "ring", id="most, ring", marks=pytest.mark.large),
        pytest.param(ALL_SLOW_AND_SOME_DEAD, "complete", id="all, complete", marks=pytest.mark.large),
    ],
)
def test_what_is_exported_makes_every_link_do_what_was_measured(
    faults: str, topology: str, agentd: Callable[..., Answer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("profiles").mkdir()
    dcf_zenoh.simulate(lossy(tmp_path, faults, topology), changes=LONG, out="run")
    lines = agentd("links", "run", "--export", "profiles/lab.json").out
    fleet = lossy(tmp_path, lines, topology)
    assert agentd("check", fleet).code == 0
    again = dcf_zenoh.simulate(fleet, changes=["seed=7", *LONG])
    for before, after in zip(link_health(Run.read("run")), link_health(again), strict=True):
        link = before.sender, before.receiver
        assert (after.sender, after.receiver) == link
        assert after.recorded == before.recorded, link
        assert (after.loss == 1.0) == (before.loss == 1.0), link
        assert after.loss == pytest.approx(before.loss, abs=0.08), link
        for probability in (0.25, 0.5, 0.75):
            assert after.latency(probability) == pytest.approx(before.latency(probability), abs=1e-4), link


def test_a_fleet_whose_links_all_are_dead_is_one_rule_and_no_profile(
    agentd: Callable[..., Answer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    dcf_zenoh.simulate(lossy(tmp_path, "[faults]\nloss = 1.0\n"), changes=SHORT, out="run")
    answer = agentd("links", "run", "--export", "lab.json")
    assert "lab.json: not written, as no latency of any link was recorded" in answer.err
    assert not Path("lab.json").exists()
    (rule,) = load(lossy(tmp_path, answer.out)).spec.faults.rule
    assert (rule.from_, rule.to) == (None, None)
    assert rule.faults["loss"].options["probability"] == 1.0  # type: ignore[union-attr]


def test_links_of_which_nothing_was_recorded_are_told_and_left_alone(
    agentd: Callable[..., Answer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    dcf_zenoh.simulate(lossy(tmp_path, DEAD_AND_SLOW), changes=SHORT, out="run")
    answer = agentd("links", "run", "--export", "lab.json")
    assert "no rule is for 6 of 8 links, of which neither latency nor loss was recorded" in answer.err
    ends = [(rule.from_, rule.to) for rule in load(lossy(tmp_path, answer.out)).spec.faults.rule]
    assert ends == [(3, 4), (1, 2)]


def test_links_to_an_agent_without_a_log_are_in_no_rule(
    agentd: Callable[..., Answer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    dcf_zenoh.simulate(lossy(tmp_path, "[faults]\nlatency = 0.001\n"), changes=SHORT, out="run")
    Path("run", log_name(3)).unlink()
    answer = agentd("links", "run", "--export", "lab.json")
    assert "lab.json: profile of 6 of 8 links" in answer.err
    assert "no rule is for 2 of 8 links" in answer.err
    (rule,) = load(lossy(tmp_path, answer.out)).spec.faults.rule
    assert (rule.from_, rule.to) == (None, (1, 2, 4))


def test_links_that_are_alike_share_a_rule() -> None:
    graph = complete(4)
    (rule,) = rules(graph, *(measured(i, j, "....") for i, j in graph.links))
    assert rule.keys() == {"latency"}
    found = rules(graph, *(measured(i, j, "xx" if (i, j) == (1, 2) else "....") for i, j in graph.links))
    latency = {"distribution": "empirical", "file": "lab.json"}
    assert found == [
        {"from": 1, "to": [3, 4], "latency": latency},
        {"from": [2, 3, 4], "latency": latency},
        {"from": 1, "to": 2, "loss": 1.0},
    ]
    dead = rules(graph, *(measured(i, j, i * "x") for i, j in graph.links if j == 3))
    assert dead == [{"to": 3, "loss": 1.0}]  # however many messages there were


def test_losses_are_exported_where_no_latency_is_known() -> None:
    graph = complete(2)
    assert rules(graph, measured(1, 2, "..xx..x.", None), measured(2, 1, "")) == [
        {"from": 1, "bursts": {"mean_loss": 0.375, "mean_length": 1.5}}
    ]


@pytest.mark.parametrize(
    "messages",
    ["x" * 50 + "." + "x" * 49, "x." * 50 + "x", "xx.", "x.", "." * 99_999 + "x", "x" * 99_999 + "."],
)
def test_a_share_of_losses_makes_a_rule_that_is_allowed_and_loses_that_share(messages: str) -> None:
    (found,) = (rule["bursts"] for rule in rules(complete(2), measured(1, 2, messages, None)))
    Bursts(**found)
    share = messages.count("x") / len(messages)
    assert found["mean_loss"] == pytest.approx(share, abs=2e-4)
    assert found["mean_loss"] > 0


@given(st.sets(st.tuples(st.integers(1, 6), st.integers(1, 6)).filter(lambda link: link[0] != link[1])), st.data())
def test_every_link_gets_its_own_faults_once_and_no_other_link_any(
    links: set[tuple[int, int]], data: st.DataObject
) -> None:
    graph = Graph.of(range(1, 7), links)
    signs = {link: data.draw(st.sampled_from(["", "...", "xxx", "x..", ".xx."])) for link in sorted(links)}
    found = [
        FaultRule.model_validate({**rule, **{name: {"kind": name} for name in rule.keys() - {"from", "to"}}})
        for rule in rules(graph, *(measured(*link, sign) for link, sign in signs.items()))
    ]
    for link, sign in signs.items():
        names = sorted(name for rule in found if rule.covers(*link) for name in rule.faults)
        wanted = {"": [], "...": ["latency"], "xxx": ["loss"]}.get(sign, ["bursts", "latency"])
        assert names == wanted
