"""Checks and drivers for algorithms, plants and topologies, built-in ones and anybody's."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dcf_zenoh.algorithms.algorithm import Algorithm, Inbox, Me, Result
from dcf_zenoh.graph import WEIGHTS, Graph, Neighbourhood
from dcf_zenoh.messaging.message import canonical


def fleet_of(graph: Graph, *, seed: int = 0, weights: str = "metropolis") -> dict[int, Me]:
    """Fresh `Me` objects of every agent of `graph`."""
    matrix = WEIGHTS[weights](graph)
    return {
        i: Me(i, graph.agents, Neighbourhood.of(graph, i, matrix), np.random.Generator(np.random.Philox([seed, i])))
        for i in graph.agents
    }


def lockstep(
    algorithm: Algorithm,
    problems: Mapping[int, Any],
    fleet: Mapping[int, Me],
    rounds: int,
    *,
    after_round: Callable[[int, Mapping[int, float]], bool] | None = None,
) -> dict[int, Result]:
    """Step the bare generators of a fleet in a plain loop: no messages, no clock, nothing lost.

    Args:
        algorithm: Options bound.
        problems: Agent -> what it solves.
        fleet: Agent -> who it is.
        rounds: After so many, `inbox.stop` is set.
        after_round: Called with the round and every agent's residual; True ends the iteration there.

    Returns:
        Agent -> result.

    Raises:
        AssertionError: An algorithm goes on after `inbox.stop`, or returns before it.
    """
    running = {i: algorithm(problems[i], me) for i, me in fleet.items()}
    said = {i: next(dialogue) for i, dialogue in running.items()}
    results: dict[int, Result] = {}
    for number in range(rounds):
        own = {i: canonical(payload) for i, (payload, _) in said.items()}  # type: ignore[arg-type]
        residuals = {i: residual for i, (_, residual) in said.items()}
        stop = bool(after_round and after_round(number, residuals)) or number + 1 == rounds
        said = {}
        for i, dialogue in running.items():
            inbox = Inbox(own[i], {j: own[j] for j in fleet[i].neighbours}, stop=stop)
            try:
                said[i] = dialogue.send(inbox)
            except StopIteration as finished:
                results[i] = finished.value
        assert len(results) == (len(running) if stop else 0), (
            f"round {number}: returned {sorted(results)}, stop is {stop}"
        )
        if stop:
            break
    return results
