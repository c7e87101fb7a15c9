"""Problems whose answers are known in closed form, and graphs to solve them on."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from dcf_zenoh.algorithms.algorithm import Algorithm
from dcf_zenoh.graph import Graph
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.absolute_value import AbsoluteValue
from dcf_zenoh.problems.cournot import Cournot
from dcf_zenoh.problems.lasso import Lasso
from dcf_zenoh.problems.quadratic import Quadratic
from dcf_zenoh.problems.quadratic_game import QuadraticGame
from dcf_zenoh.problems.resource_allocation import ResourceAllocation
from dcf_zenoh.testing import Delay, fleet_of, in_time, lockstep
from topologies.complete import complete
from topologies.erdos_renyi import erdos_renyi
from topologies.path import path
from topologies.ring import ring
from topologies.star import star

AGENTS = (1, 2, 3, 4)
TOPOLOGIES: dict[str, Callable[..., Any]] = {"complete": complete, "ring": ring, "path": path, "star": star}
Problems = dict[int, Any]


def graph(topology: str, agents: tuple[int, ...] = AGENTS) -> Graph:
    return Graph.of(agents, TOPOLOGIES[topology](agents))


def quadratic(**bounds: float) -> Problems:
    """P1: the least sum is at 1; with x <= 0.5 there."""
    costs = zip(AGENTS, (1.0, 2.0, 3.0, 4.0), (4.0, -1.0, 2.0, 0.5), strict=True)
    return {i: Quadratic(centre=centre, weight=weight, **bounds) for i, weight, centre in costs}


def median() -> Problems:
    """The median of 0, 1, 2, 7, 9."""
    return {i: AbsoluteValue(value=value) for i, value in enumerate((0.0, 1.0, 2.0, 7.0, 9.0), 1)}


def allocation() -> Problems:
    """P3: (4, 3, 1.5, 1.5), at the price -6."""
    limits = zip(AGENTS, (1.0, 2.0, 4.0, 4.0), (4.0, 100.0, 100.0, 100.0), strict=True)
    return {i: ResourceAllocation(AGENTS, demand=10.0, weight=weight, upper=most) for i, weight, most in limits}


def cournot(capacity: float | None = None) -> Problems:
    """P4: (3, 2, 1, 0); with a capacity of 4 (7/3, 4/3, 1/3, 0), at the price 8/3."""
    return {i: Cournot(i, AGENTS, cost=float(i), capacity=capacity) for i in AGENTS}


def two_players() -> Problems:
    """P5: (1, 2)."""
    rows = {1: ([1.0, 1.0], -3.0), 2: ([-1.0, 1.0], -1.0)}
    return {i: QuadraticGame(i, (1, 2), row=row, constant=constant) for i, (row, constant) in rows.items()}


def random_graph(seed: int, count: int = 6) -> Graph:
    agents = tuple(range(1, count + 1))
    return Graph.of(agents, erdos_renyi(agents, probability=0.5, seed=seed))


def random_quadratic(seed: int, agents: tuple[int, ...], size: int = 3) -> tuple[Problems, Array]:
    """Weights in [1, 4], normal centres; and the weighted mean of the centres."""
    rng = np.random.default_rng(seed)
    weights, centres = rng.uniform(1, 4, (len(agents), size)), rng.normal(size=(len(agents), size))
    problems = {
        i: Quadratic(centre=centre.tolist(), weight=weight.tolist())
        for i, weight, centre in zip(agents, weights, centres, strict=True)
    }
    answer: Array = (weights * centres).sum(axis=0) / weights.sum(axis=0)
    return problems, answer


def lasso(seed: int, agents: tuple[int, ...]) -> tuple[dict[int, Lasso], Array]:
    """Data of four agents, and the answer by L-BFGS-B, for x = p - n with p, n >= 0."""
    problems = {i: Lasso(i, agents, size=6, rows=5, seed=seed, l1=2.0) for i in agents}
    A, b = np.vstack([each.A for each in problems.values()]), np.concatenate([each.b for each in problems.values()])

    def cost(v: Array) -> tuple[float, Array]:
        missed = A @ (v[:6] - v[6:]) - b
        slope = A.T @ missed
        return float(missed @ missed / 2 + 2.0 * v.sum()), np.concatenate((slope, -slope)) + 2.0

    options = {"ftol": 1e-15, "gtol": 1e-12, "maxiter": 10_000, "maxfun": 100_000}
    v = minimize(cost, np.zeros(12), jac=True, bounds=[(0, None)] * 12, method="L-BFGS-B", options=options).x
    return problems, v[:6] - v[6:]


def everywhere(value: float | Array, agents: tuple[int, ...] = AGENTS) -> dict[int, Array]:
    return {i: np.atleast_1d(value) for i in agents}


def each(*values: float) -> dict[int, Array]:
    return {i: np.array([value]) for i, value in enumerate(values, 1)}


class Course(NamedTuple):
    """How a fleet came near its answer: the largest error of any agent after each round, and what all decided."""

    errors: Array
    decisions: dict[int, Array]
    memories: dict[int, Mapping[str, Any]]

    @property
    def error(self) -> float:
        """At the end."""
        return float(self.errors[-1])

    @property
    def rate(self) -> float:
        """Factor per round, fitted over the rounds after the first third and before rounding matters."""
        small = np.flatnonzero(self.errors < 1e-11)
        end = int(small[0]) if small.size else len(self.errors)
        rounds = np.arange(end // 3, end)
        return float(np.exp(np.polyfit(rounds, np.log(self.errors[rounds]), 1)[0]))

    @property
    def straightness(self) -> float:
        """Correlation of the logarithm of the error with the round: near -1 where the rate is linear."""
        small = np.flatnonzero(self.errors < 1e-11)
        end = int(small[0]) if small.size else len(self.errors)
        rounds = np.arange(end // 3, end)
        return float(np.corrcoef(rounds, np.log(self.errors[rounds]))[0, 1])


def course(
    algorithm: Algorithm,
    problems: Problems,
    graph: Graph,
    answers: Mapping[int, Array],
    rounds: int,
    *,
    links: Delay = in_time,
    weights: str = "metropolis",
) -> Course:
    """Solve in lockstep, and compare what the algorithm notes in each round, x or u, with the answers."""
    fleet = fleet_of(graph, weights=weights)
    errors: list[float] = []

    def watch(number: int, _residuals: Mapping[int, float]) -> bool:
        if number:
            noted = {i: me.noted["x" if "x" in me.noted else "u"] for i, me in fleet.items()}
            errors.append(max(float(abs(noted[i] - answers[i]).max()) for i in fleet))
        return False

    results = lockstep(algorithm, problems, fleet, rounds, links=links, after_round=watch)
    decisions = {i: result.decision for i, result in results.items()}
    errors.append(max(float(abs(decisions[i] - answers[i]).max()) for i in fleet))
    return Course(np.array(errors), decisions, {i: result.memory for i, result in results.items()})
