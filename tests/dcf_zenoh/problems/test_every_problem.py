"""Every installed problem keeps the contract, and the contract finds what breaks it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dcf_zenoh.plant import Array
from dcf_zenoh.plugins import known, load
from dcf_zenoh.problems.absolute_value import AbsoluteValue
from dcf_zenoh.problems.average import Average
from dcf_zenoh.problems.cournot import Cournot
from dcf_zenoh.problems.distance_swap import DistanceGame, DistanceSwap
from dcf_zenoh.problems.formation import Formation
from dcf_zenoh.problems.lasso import Lasso
from dcf_zenoh.problems.position_swap import PositionSwap
from dcf_zenoh.problems.quadratic import Quadratic
from dcf_zenoh.problems.quadratic_game import QuadraticGame
from dcf_zenoh.problems.rendezvous import Rendezvous
from dcf_zenoh.problems.resource_allocation import ResourceAllocation
from dcf_zenoh.problems.share import Share
from dcf_zenoh.problems.shared.swap_options import BarrierOptions, PredictionOptions
from dcf_zenoh.testing import check_problem
from tests.support.references import Reference

THREE = (1, 2, 5)
STATES = {2: np.array([1.0, -2.0, 0.3, 0.1])}
SPREAD = {i: np.array([1.0 - i, 0.3 * i, 0.1, -0.2]) for i in THREE}
MADE: dict[str, list[Callable[[], object]]] = {
    "absolute_value": [
        lambda: AbsoluteValue(value=2.0),
        lambda: AbsoluteValue(value=[1.0, -1.0], weight=[0.5, 2.0], lower=0.0, upper=[0.5, 3.0]),
    ],
    "average": [lambda: Average(value=3.0), lambda: Average(value=[1.0, -2.0])],
    "cournot": [
        lambda: Cournot(2, THREE, cost=1.0),
        lambda: Cournot(2, THREE, cost=1.0, slope=0.5, capacity=4.0, upper=2.0),
    ],
    "distance_swap": [
        lambda: DistanceSwap(2, THREE, 0.2, target=(0.0, 1.0)).at(SPREAD),
        lambda: DistanceSwap(
            5, THREE, 0.2, target=(0.0, 1.0), prediction=PredictionOptions(4), barrier=BarrierOptions((0.5, 0.5))
        ).at(SPREAD),
    ],
    "formation": [
        lambda: Formation(2, 0.2, offset=(0.5, 0.0)).at(STATES),
        lambda: Formation(2, 0.2, offset=(0.5, 0.0), goal=(3.0, 1.0), pull=2.0).at(STATES),
    ],
    "lasso": [lambda: Lasso(2, THREE), lambda: Lasso(5, THREE, size=6, rows=2, l1=3.0, seed=4)],
    "position_swap": [
        lambda: Reference.read("n4_star_boxactive").games[2],
        lambda: Reference.read("n6_line_nonpotential").games[0],
    ],
    "quadratic": [
        lambda: Quadratic(centre=2.0),
        lambda: Quadratic(centre=[1.0, -1.0], weight=[0.5, 2.0], lower=[-np.inf, 0.0], upper=0.5),
    ],
    "quadratic_game": [lambda: QuadraticGame(2, THREE, row=[0.5, 2.0, -1.0], constant=1.0, upper=0.5)],
    "rendezvous": [lambda: Rendezvous(2, 0.2).at(STATES)],
    "resource_allocation": [
        lambda: ResourceAllocation(THREE, demand=3.0),
        lambda: ResourceAllocation(
            THREE, demand=[3.0, 1.0], exactly=False, weight=[0.5, 2.0], centre=[1.0, 0.0], upper=[1.5, 2.0]
        ),
    ],
}


def test_every_installed_problem_is_tried() -> None:
    assert sorted(MADE) == sorted(known("problems"))


@pytest.mark.parametrize("kind", sorted(MADE))
def test_every_kind_keeps_the_contract(kind: str) -> None:
    for make in MADE[kind]:
        check_problem(make)


@pytest.mark.parametrize("kind", sorted(known("problems")))
def test_every_kind_says_what_it_is(kind: str) -> None:
    summary = (load("problems", kind, Path()).__doc__ or "").splitlines()[0]
    assert 30 < len(summary) < 120


SWAP = PositionSwap(2, THREE, 0.2, target=(0.0, 1.0))


class Steeper(Quadratic):
    def gradient(self, x: Array) -> Array:
        return 1.1 * super().gradient(x)


class Concave(Quadratic):
    smooth = False

    def cost(self, x: Array) -> float:
        return -super().cost(x)


class Restless(Quadratic):
    def __init__(self) -> None:
        super().__init__(centre=1.0)
        self._count = 0

    def gradient(self, x: Array) -> Array:
        self._count += 1
        return super().gradient(x) + 1e-9 * id(self) + self._count


class Careless(Quadratic):
    def argmin(self, slope: Array, weight: float) -> Array:
        return super().argmin(slope, weight) + 0.1


class Greedy(Quadratic):
    def gradient(self, x: Array) -> Array:
        x -= 1.0
        return super().gradient(x)


class Untrue(Quadratic):
    def share(self) -> Share:
        return Share(np.eye(1), np.zeros(1), np.zeros(1), np.zeros(1), common=True)


class Stretching(Quadratic):
    def project(self, x: Array) -> Array:
        return 2.0 * x


class Bent(DistanceGame):
    def constraints(self, outputs: Array) -> tuple[Array, Array]:
        c, derivative = super().constraints(outputs)
        return c, 1.1 * derivative


@pytest.mark.parametrize(
    ("make", "error", "text"),
    [
        (lambda: Bent(SWAP, SPREAD), AssertionError, r"(?s)constraints: .*but they rise by"),
        (lambda: Steeper(centre=1.0), AssertionError, r"gradient"),
        (lambda: Concave(centre=1.0), AssertionError, r"cost\(x\) \+ gradient\(x\)'\(y - x\), beside cost\(y\)"),
        (Restless, AssertionError, r"gradient\(x\) is not repeatable"),
        (lambda: Careless(centre=1.0), AssertionError, "least cost with weight 0, beside another point's"),
        (lambda: Greedy(centre=1.0), ValueError, "read-only"),
        (lambda: Untrue(centre=1.0), AssertionError, r"share\(\): H x \+ g"),
        (lambda: Stretching(centre=1.0), AssertionError, r"project\(project\(x\)\)"),
        (object, AssertionError, "object derives from none of MeanProblem, ConsensusProblem"),
    ],
)
def test_a_broken_problem_is_found_out(make: Callable[[], object], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        check_problem(make)
