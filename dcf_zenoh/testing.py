"""What algorithms and plants must satisfy, built-in ones and anybody's, and a fleet in a plain loop to drive them."""

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations
from typing import Any

import numpy as np

from dcf_zenoh.algorithms.algorithm import Algorithm, Inbox, Me, Result
from dcf_zenoh.graph import WEIGHTS, Graph, Neighbourhood
from dcf_zenoh.messaging.message import Payload, canonical
from dcf_zenoh.plant import Plant, Setpoint


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


def check_algorithm(
    algorithm: Algorithm, problems: Callable[[], Mapping[int, Any]], graph: Graph, *, rounds: int = 6
) -> None:
    """The contract of an algorithm, on one problem and graph.

    It returns a result in the very round in which `inbox.stop` is set, whichever that is and whoever is missing in it;
    it changes nothing it received; and it does the same again when everything is the same.

    Args:
        algorithm: Options bound.
        problems: Makes fresh problems, agent -> what it solves.
        graph: Who hears whom.
        rounds: How far to go.

    Raises:
        AssertionError: It breaks the contract; the message says how.
    """
    for last in range(1, rounds + 1):
        first, second = (lockstep(algorithm, problems(), fleet_of(graph), last) for _ in range(2))
        for i, result in first.items():
            assert isinstance(result, Result), f"agent {i} returned {result!r:.60}; expected me.result(decision)"
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
    """One round in which some neighbours are missing."""
    running = {i: algorithm(problems[i], me) for i, me in fleet_of(graph).items()}
    sent: dict[int, Payload] = {i: canonical(next(dialogue)[0]) for i, dialogue in running.items()}  # type: ignore[arg-type]
    before = {i: canonical(payload) for i, payload in sent.items()}
    heard = {j: sent[j] for j in graph.in_neighbours(agent) if j not in missing}
    place = f"agent {agent}, {list(missing)} missing, stop is {stop}"
    try:
        payload, residual = running[agent].send(Inbox(sent[agent], heard, stop=stop, missing=missing))
    except StopIteration as finished:
        assert stop, f"{place}: it returned without need"
        assert isinstance(finished.value, Result), f"{place}: it returned {finished.value!r:.60}"
    else:
        assert not stop, f"{place}: it went on"
        canonical(payload)  # type: ignore[arg-type]
        assert residual == residual, f"{place}: its residual is not a number"  # noqa: PLR0124
    for i, values in before.items():
        for name, value in values.items():
            assert np.array_equal(value, sent[i][name], equal_nan=True), f"{place}: it changed {name!r} of agent {i}"


def check_plant(make: Callable[[], Plant], *, sample_time: int = 200_000_000, steps: int = 20) -> None:
    """The contract of a simulated plant: sensing changes nothing, states are read-only, holding comes to rest.

    Args:
        make: Makes a fresh plant, the same each time.
        sample_time: In ns.
        steps: How many setpoints it gets.

    Raises:
        AssertionError: It breaks the contract; the message says how.
    """
    seldom, often = make(), make()
    for plant in (seldom, often):
        plant.prepare()
        plant.start(0)
    rng = np.random.default_rng(0)
    for step in range(steps):
        now = step * sample_time
        state, again = seldom.sense(now), often.sense(now)
        assert np.allclose(state.vector, again.vector, rtol=1e-9, atol=1e-9), f"step {step}: sensing moves the plant"
        assert np.array_equal(often.sense(now).vector, again.vector), f"step {step}: two states at one instant"
        assert state.position.shape == state.velocity.shape, f"step {step}: position and velocity differ in shape"
        locked = [not array.flags.writeable for array in (state.position, state.velocity)]
        assert all(locked), f"step {step}: a state can be changed"
        setpoint = Setpoint(state.position, state.velocity, rng.uniform(-1, 1, state.position.shape))
        for plant in (seldom, often):
            plant.act(setpoint, now)
        often.sense(now + sample_time // 3)
    end = steps * sample_time
    seldom.act(Setpoint.hold(seldom.sense(end)), end)
    rest = seldom.sense(end + 100 * sample_time)
    later = seldom.sense(end + 101 * sample_time)
    assert np.allclose(rest.velocity, 0, atol=1e-3), f"it still moves at {rest.velocity} m/s long after it was to hold"
    assert np.allclose(rest.position, later.position, atol=1e-3), "it does not stay where it holds"
    for plant in (seldom, often):
        plant.finish(end, "done")
        plant.close()
        plant.close()
