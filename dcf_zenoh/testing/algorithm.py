"""Contract check for algorithms."""

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations
from typing import Any

import numpy as np

from dcf_zenoh.algorithms.algorithm import Algorithm, Inbox, Result
from dcf_zenoh.graph import Graph
from dcf_zenoh.testing.equality import same_payload
from dcf_zenoh.testing.lockstep import as_received, as_sent, fleet_of, lockstep, residual_of


def check_algorithm(
    algorithm: Algorithm, problems: Callable[[], Mapping[int, Any]], graph: Graph, *, rounds: int = 6
) -> None:
    """Check the contract of an algorithm on one problem and graph.

    The algorithm returns a result in the round in which `inbox.stop` is set, in every round and with any neighbours
    missing. It does not modify what it received. Its residuals are numbers >= 0 and its decisions finite. Equal inputs
    give equal results.

    Args:
        algorithm: Algorithm with its options bound.
        problems: Makes new problems, agent -> problem.
        graph: Topology.
        rounds: Largest number of rounds to try.

    Raises:
        AssertionError: The algorithm breaks the contract; the message states how.
    """
    for last in range(1, rounds + 1):
        first, second = (lockstep(algorithm, problems(), fleet_of(graph), last) for _ in range(2))
        for i, result in first.items():
            assert isinstance(result, Result), f"agent {i} returned {result!r:.60}; expected me.result(decision)"
            assert np.isfinite(result.decision).all(), f"agent {i} returned a decision that is not finite"
            assert np.array_equal(result.decision, second[i].decision, equal_nan=True), f"agent {i} is not repeatable"
    agent = graph.agents[0]
    for missing in _subsets(graph.in_neighbours(agent)):
        for stop in (False, True):
            _check_missing(algorithm, problems(), graph, agent, missing, stop=stop)


def _subsets(agents: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    for size in range(len(agents) + 1):
        yield from combinations(agents, size)


def _check_missing(
    algorithm: Algorithm, problems: Mapping[int, Any], graph: Graph, agent: int, missing: tuple[int, ...], *, stop: bool
) -> None:
    """Check one round in which some neighbours are missing."""
    running = {i: algorithm(problems[i], me) for i, me in fleet_of(graph).items()}
    yielded = {i: next(dialogue)[0] for i, dialogue in running.items()}
    sent = {i: as_sent(payload) for i, payload in yielded.items()}
    before = {i: as_sent(payload) for i, payload in yielded.items()}
    received = {j: as_received(agent, yielded[j], sent[j]) for j in graph.in_neighbours(agent) if j not in missing}
    place = f"agent {agent}, {list(missing)} missing, stop is {stop}"
    try:
        payload, residual = running[agent].send(Inbox(sent[agent], received, stop=stop, missing=missing))
    except StopIteration as finished:
        assert stop, f"{place}: it returned without need"
        assert isinstance(finished.value, Result), f"{place}: it returned {finished.value!r:.60}"
    else:
        assert not stop, f"{place}: it went on"
        residual_of((payload, residual), place)
        as_sent(payload)
    for i, values in before.items():
        for name, value in values.items():
            assert same_payload(value, sent[i][name]), f"{place}: it changed {name!r} of agent {i}"
