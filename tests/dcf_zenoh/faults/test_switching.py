"""Graphs that change from round to round, and the algorithms that bear it."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

import agentd.fleets
import dcf_zenoh
from dcf_zenoh.faults.fault import Fault
from dcf_zenoh.faults.switching import Pairs, Switching
from dcf_zenoh.message import Last, Message
from dcf_zenoh.messaging.delivery import Delivery
from tests.support.fleet_files import problems

ALTERNATING: tuple[Pairs, ...] = (((1, 2), (3, 4)), ((2, 3),))
SETTING = [
    "time.sample_time=20.0",
    "exchange.round_timeout=0.001",
    "exchange.max_rounds=2500",
    "exchange.missing=absent",
]
SCHEDULE = "faults.switching.graphs=[[[1,2],[3,4]],[[2,3]]]"


def passes(fault: Fault, round: int, step: int = 0) -> bool:
    message = Message(1, 0, round, step, round, 0, -1, -1, 0, Last.NO, (1.0,), (), {})
    return bool(fault.apply(Delivery(message, 0, 0), np.random.default_rng(round)))


def test_both_directions_of_a_pair_are_there_in_the_same_rounds() -> None:
    for i, j in combinations((1, 2, 3), 2):
        one, other = (Switching(*link, probability=0.4, seed=3) for link in ((i, j), (j, i)))
        rounds = [passes(one, round) for round in range(200)]
        assert rounds == [passes(other, round) for round in range(200)]
        assert 50 < sum(rounds) < 110


def test_every_pair_step_and_seed_has_draws_of_its_own() -> None:
    def rounds(link: tuple[int, int], seed: int, step: int) -> tuple[bool, ...]:
        return tuple(passes(Switching(*link, probability=0.5, seed=seed), round, step) for round in range(60))

    assert len({rounds((1, 2), 0, 0), rounds((1, 3), 0, 0), rounds((1, 2), 1, 0), rounds((1, 2), 0, 1)}) == 4


def test_graphs_follow_each_other_and_start_again() -> None:
    first, second = (Switching(*link, graphs=ALTERNATING, rounds=2) for link in ((4, 3), (2, 3)))
    assert [passes(first, round) for round in range(6)] == [True, True, False, False, True, True]
    assert [passes(second, round) for round in range(6)] == [False, False, True, True, False, False]
    assert [passes(first, 0, step) for step in range(3)] == [True, False, True]  # a short step goes on where one ended


@pytest.mark.parametrize("change", ["faults.switching=0.5", SCHEDULE])
@pytest.mark.parametrize("algorithm", ["gradient_tracking", "edge_admm"])
def test_the_least_sum_is_found_on_a_graph_that_is_never_connected(algorithm: str, change: str) -> None:
    changes = [*SETTING, change] + (["algorithm.step=0.05"] if algorithm == "gradient_tracking" else [])
    run = dcf_zenoh.simulate("quadratic", algorithm=algorithm, changes=changes)
    for log in run.agents.values():
        np.testing.assert_allclose(log.decision[-1], [1.0], atol=1e-6)
        assert log.links
    share = run.summary()["messages"]
    assert 0.3 < share["lost"] / share["published"] < 1.5


def test_consensus_keeps_the_mean_where_links_come_and_go_but_not_where_messages_get_lost() -> None:
    def error(change: str) -> float:
        run = dcf_zenoh.simulate("average", changes=[*SETTING, change, "exchange.threshold=0"])
        return max(float(abs(log.decision[-1] - 4.0).max()) for log in run.agents.values())

    assert error("faults.switching=0.4") < 1e-9
    assert error("faults.loss=0.6") > 0.05


def test_trades_keeps_its_trackers() -> None:
    changes = [*SETTING, "faults.switching=0.6", "exchange.threshold=1e-9"]
    run = dcf_zenoh.simulate("cournot", changes=changes)
    for log, answer in zip(run.agents.values(), (7 / 3, 4 / 3, 1 / 3, 0.0), strict=True):
        np.testing.assert_allclose(log.decision[-1], [answer], atol=1e-5)


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({}, "expected one of probability and graphs"),
        ({"probability": 0.5, "graphs": ALTERNATING}, "expected one of probability and graphs"),
        ({"probability": 1.5}, "probability must be a probability, from 0 to 1, not 1.5"),
        ({"probability": 0.5, "rounds": 0}, "rounds must be at least 1, not 0"),
        ({"probability": 0.5, "seed": -1}, "seed must be at least 0, not -1"),
        ({"graphs": (((1, 2),), ((3, 4),))}, r"graphs must connect all agents together; nothing joins \[1, 2\] and"),
        ({"graphs": (((2, 3),),)}, "graphs must have a link of every agent, and have none of agent 1"),
        ({"graphs": ()}, "graphs must have a link of every agent"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(keys: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Switching(1, 2, **keys)  # type: ignore[arg-type]


def test_graphs_that_do_not_connect_the_fleet_are_found_by_check() -> None:
    fleet = Path(agentd.fleets.__file__).parent / "quadratic.toml"
    changes = ["exchange.round_timeout=0.001", "faults.switching.graphs=[[[1,2]],[[3,4]]]"]
    assert problems(fleet, *changes) == [
        "faults.switching.graphs: must connect all agents together; nothing joins [1, 2] and [3, 4]"
    ]
    assert problems(fleet, changes[0], "faults.switching.graphs=[[[1,2],[2,3],[3,9]]]")[0].startswith(
        "faults.switching.graphs: there is no agent 9"
    )
