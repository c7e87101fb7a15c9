"""A fleet in a plain loop, to drive algorithms: no messages, no clock."""

from collections.abc import Callable, Generator, Mapping, Set
from typing import Any, TypeAlias, TypeVar

import numpy as np

from dcf_zenoh.algorithms.algorithm import Algorithm, Dialogue, Inbox, Me, PerNeighbour, Result
from dcf_zenoh.graph import WEIGHTS, Graph, Neighbourhood
from dcf_zenoh.message import Payload, canonical

T = TypeVar("T")
Delay: TypeAlias = Callable[[int, int, int], int | None]  # sender, receiver, round -> rounds on the way; None: lost


def fleet_of(graph: Graph, *, seed: int = 0, weights: str = "metropolis") -> dict[int, Me]:
    """Fresh `Me` objects of every agent of `graph`."""
    matrix = WEIGHTS[weights](graph)
    return {
        i: Me(i, graph.agents, Neighbourhood.of(graph, i, matrix), np.random.Generator(np.random.Philox([seed, i])))
        for i in graph.agents
    }


def in_time(_sender: int, _receiver: int, _round: int) -> int | None:
    """Every message arrives in its round."""
    return 0


def lossy(seed: int, loss: float, delay: int = 0) -> Delay:
    """Links that lose each message independently with probability `loss`, and take `delay` rounds for the others."""
    rng = np.random.default_rng(seed)
    return lambda _sender, _receiver, _round: None if rng.random() < loss else delay


def lockstep(
    algorithm: Algorithm,
    problems: Mapping[int, Any],
    fleet: Mapping[int, Me],
    rounds: int,
    *,
    links: Delay = in_time,
    after_round: Callable[[int, Mapping[int, float]], bool] | None = None,
) -> dict[int, Result]:
    """Step the bare generators of a fleet in a plain loop: no messages, no clock, nothing lost unless `links` say so.

    Args:
        algorithm: Options bound.
        problems: Agent -> what it solves.
        fleet: Agent -> who it is.
        rounds: After so many, `inbox.stop` is set.
        links: Sender, receiver, round -> rounds until the message is there, or None: it never is.
        after_round: Called with the round and every agent's residual; True ends the iteration there.

    Returns:
        Agent -> result.

    Raises:
        AssertionError: An algorithm goes on after `inbox.stop`, or returns before it.
    """
    running = {i: algorithm(problems[i], me) for i, me in fleet.items()}
    return converse(running, fleet, rounds, links=links, after_round=after_round)


def converse(
    dialogues: Mapping[int, Dialogue[T]],
    fleet: Mapping[int, Me],
    rounds: int,
    *,
    links: Delay = in_time,
    after_round: Callable[[int, Mapping[int, float]], bool] | None = None,
) -> dict[int, T]:
    """Let the dialogues of a fleet, be it of algorithms or of controllers, speak in a plain loop; see `lockstep`."""
    for i, dialogue in dialogues.items():
        assert isinstance(dialogue, Generator), f"agent {i}: it is no generator: it has no yield"
    said = {i: next(dialogue) for i, dialogue in dialogues.items()}
    waiting: dict[tuple[int, int], list[tuple[int, int, Payload]]] = {}  # link -> (due, sent, payload), in rounds
    heard: dict[tuple[int, int], tuple[int, int, Payload]] = {}  # link -> (first seen, sent, payload)
    names: dict[int, tuple[Set[Any], int]] = dict.fromkeys(dialogues, (frozenset(), 0))  # of own payload, since when
    results: dict[int, T] = {}
    for number in range(rounds):
        residuals = {i: residual_of(each, f"agent {i}, round {number}") for i, each in said.items()}
        own = {i: as_sent(payload) for i, (payload, _) in said.items()}
        stop = bool(after_round and after_round(number, residuals)) or number + 1 == rounds
        spoken, said = said, {}
        for i, dialogue in dialogues.items():
            if own[i].keys() != names[i][0]:
                names[i] = own[i].keys(), number
            payloads: dict[int, Payload] = {}
            ages, news, missing = {}, [], []
            for j in fleet[i].neighbours:
                link = waiting.setdefault((j, i), [])
                if (delay := links(j, i, number)) is not None:
                    link.append((number + delay, number, as_heard(i, spoken[j][0], own[j])))
                for message in [each for each in link if each[0] <= number]:
                    link.remove(message)
                    if (j, i) not in heard or message[1] > heard[j, i][1]:
                        heard[j, i] = (number, *message[1:])
                seen, sent, payload = heard.get((j, i), (-1, -1, {}))
                if seen < number and sent < names[i][1]:
                    missing.append(j)
                    continue
                payloads[j], ages[j] = payload, number - sent
                if seen == number:
                    news.append(j)
            inbox = Inbox(own[i], payloads, stop=stop, ages=ages, news=news, missing=tuple(missing))
            try:
                said[i] = dialogue.send(inbox)
            except StopIteration as finished:
                results[i] = finished.value
        assert len(results) == (len(dialogues) if stop else 0), (
            f"round {number}: returned {sorted(results)}, stop is {stop}"
        )
        if stop:
            break
    return results


def residual_of(said: Any, place: str) -> float:
    """The residual of what was yielded, which must be a payload and a residual."""
    try:
        _payload, residual = said
        number = float(residual)
    except (TypeError, ValueError):
        raise AssertionError(f"{place}: it yielded {said!r:.60}; expected a payload and a residual") from None
    assert number >= 0, f"{place}: its residual is {number:g}; expected a number >= 0"
    return number


def as_sent(payload: Payload | PerNeighbour) -> Mapping[Any, Any]:
    """What an inbox shows as the agent's own payload: canonical; of edge payloads, neighbour -> payload."""
    if isinstance(payload, PerNeighbour):
        return {j: canonical(each) for j, each in payload.payloads.items()}
    return canonical(payload)


def as_heard(receiver: int, said: Payload | PerNeighbour, sent: Mapping[Any, Any]) -> Payload:
    """What `receiver` hears of what was sent."""
    payload: Payload = sent[receiver] if isinstance(said, PerNeighbour) else sent
    return payload
