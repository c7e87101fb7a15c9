"""The contract checks pass kinds that keep the contract, built-in ones among them, and find those that break it."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.algorithms.algorithm import Algorithm, Dialogue, Me, Result
from dcf_zenoh.algorithms.average_consensus import average_consensus
from dcf_zenoh.algorithms.trades import trades
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import NoPlant, Plant, Setpoint, State
from dcf_zenoh.problems.average import Average
from dcf_zenoh.testing import check_algorithm, check_plant
from plants.point_mass import PointMass
from tests.support.references import Reference
from topologies.complete import complete
from topologies.ring import ring

AGENTS = (1, 2, 3, 4)


def values() -> Mapping[int, Average]:
    return {i: Average(value=[float(i), -1.0]) for i in AGENTS}


@pytest.mark.parametrize("topology", [complete, ring])
def test_average_consensus_keeps_the_contract(topology: Any) -> None:
    check_algorithm(average_consensus, values, Graph.of(AGENTS, topology(AGENTS)))


@pytest.mark.parametrize("name", ["n4_complete_start", "n6_line_nonpotential"])
@pytest.mark.parametrize("order", ["adapt_then_combine", "combine_then_adapt"])
def test_trades_keeps_the_contract(name: str, order: Any) -> None:
    reference = Reference.read(name)
    check_algorithm(partial(trades, order=order), lambda: reference.games, reference.graph)


def late(_problem: object, me: Me) -> Dialogue[Result]:
    stop = False
    while not stop:
        stop = (yield {"x": 1.0}, 0.0).stop
    yield {"x": 1.0}, 0.0
    return me.result([1.0])


def bare(_problem: object, _me: Me) -> Dialogue[Any]:
    while not (yield {"x": 1.0}, 0.0).stop:
        pass
    return np.ones(1)


def demanding(_problem: object, me: Me) -> Dialogue[Result]:
    total = 0.0
    while True:
        inbox = yield {"x": 1.0}, 0.0
        total += sum(float(np.sum(inbox[j]["x"])) for j in me.neighbours)
        if inbox.stop:
            return me.result([total])


def forgetful(problem: Average, me: Me, *, memory: list[int]) -> Dialogue[Result]:
    memory.append(0)
    while not (yield {"x": problem.value}, 0.0).stop:
        pass
    return me.result([float(len(memory))])


def says(*said: Any, decision: float = 0.0) -> Algorithm:
    def algorithm(_problem: object, me: Me) -> Dialogue[Result]:
        while not (yield said).stop:
            pass
        return me.result([decision])

    return algorithm


def grasping(_problem: object, me: Me) -> Dialogue[Result]:
    while True:
        inbox = yield {"x": 1.0}, 0.0
        for j in inbox:
            inbox[j]["x"] = 2.0  # type: ignore[index]
        if inbox.stop:
            return me.result([0.0])


@pytest.mark.parametrize(
    ("algorithm", "error", "text"),
    [
        (says({"x": 1.0}), AssertionError, "agent 1, round 0: it yielded .*; expected a payload and a residual"),
        (says({"x": 1.0}, None), AssertionError, "agent 1, round 0: it yielded .*; expected a payload and a residual"),
        (says({"x": 1.0}, -1.0), AssertionError, "agent 1, round 0: its residual is -1; expected a number >= 0"),
        (says({"x": 1.0}, np.nan), AssertionError, "agent 1, round 0: its residual is nan; expected a number >= 0"),
        (says({"x": 1.0}, 0.0, decision=np.inf), AssertionError, "agent 1 returned a decision that is not finite"),
        (lambda _problem, me: me.result([0.0]), AssertionError, "agent 1: it is no generator: it has no yield"),
        (grasping, TypeError, "does not support item assignment"),
        (late, AssertionError, "round 0: returned .., stop is True"),
        (bare, AssertionError, r"agent 1 returned array\(\[1.\]\); expected me.result"),
        (demanding, KeyError, "2"),
        (partial(forgetful, memory=[]), AssertionError, "agent 1 is not repeatable"),
    ],
)
def test_a_broken_algorithm_is_found_out(algorithm: Algorithm, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        check_algorithm(algorithm, values, Graph.of(AGENTS, ring(AGENTS)))


def test_the_built_in_plants_keep_the_contract() -> None:
    check_plant(lambda: PointMass(np.array([1.0, 2.0]), velocity=(0.3, -0.2)))
    check_plant(lambda: PointMass(np.zeros(3)))
    check_plant(NoPlant)


class Drifting(Plant):
    """Moves with every measurement."""

    def __init__(self) -> None:
        self.looks = 0

    def sense(self, now: int) -> State:
        self.looks += 1
        return State(np.full(2, float(self.looks)), np.zeros(2))

    def act(self, setpoint: Setpoint, now: int) -> None:
        pass


def test_a_broken_plant_is_found_out() -> None:
    with pytest.raises(AssertionError, match="two states at one instant"):
        check_plant(Drifting)
