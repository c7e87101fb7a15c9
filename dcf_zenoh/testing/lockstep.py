"""Fleet in a plain loop that runs algorithms and controllers in lockstep, without messages and clock."""

from collections.abc import Callable, Generator, Mapping, Set
from typing import Any, TypeAlias, TypeVar

import numpy as np

from dcf_zenoh.algorithms.algorithm import Algorithm, Dialogue, Inbox, Me, PerNeighbour, Result
from dcf_zenoh.graph import WEIGHTS, Graph, Neighbourhood
from dcf_zenoh.message import Payload, canonical

T = TypeVar("T")
Delay: TypeAlias = Callable[[int, int, int], int | None]  # sender, receiver, round -> rounds on the way; None: lost


def fleet_of(graph: Graph, *, seed: int = 0, weights: str = "metropolis") -> dict[int, Me]:
    """Return a new `Me` for every agent of `graph`.

    Args:
        graph: Topology.
        seed: Seed of the agents' random numbers.
        weights: Rule for the mixing weights, a key of `dcf_zenoh.graph.WEIGHTS`.
    """
    matrix = WEIGHTS[weights](graph)
    return {
        i: Me(i, graph.agents, Neighbourhood.of(graph, i, matrix), np.random.Generator(np.random.Philox([seed, i])))
        for i in graph.agents
    }


def in_time(_sender: int, _receiver: int, _round: int) -> int | None:
    """Deliver every message in the round in which it is sent."""
    return 0


def lossy(seed: int, loss: float, delay: int = 0) -> Delay:
    """Return links that lose each message with probability `loss`, and take `delay` rounds for the others."""
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
    """Run an algorithm on a fleet in a plain loop, in which every agent takes each round at the same time.

    Args:
        algorithm: Algorithm with its options bound.
        problems: Agent -> problem.
        fleet: Agent -> its `Me`, from `fleet_of`.
        rounds: Number of rounds; `inbox.stop` is set in the last.
        links: Sender, receiver, round -> rounds until the message is received; None: it is lost.
        after_round: Called with the round and agent -> residual; True ends the iteration in this round.

    Returns:
        Agent -> result.

    Raises:
        AssertionError: An algorithm continues after `inbox.stop`, returns before it, or yields something other than a
            payload and a residual >= 0.
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
    """Run dialogues of a fleet, of algorithms or of controllers, in a plain loop; see `lockstep` for the arguments."""
    for i, dialogue in dialogues.items():
        assert isinstance(dialogue, Generator), f"agent {i}: it is no generator: it has no yield"
    yielded = {i: next(dialogue) for i, dialogue in dialogues.items()}
    waiting: dict[tuple[int, int], list[tuple[int, int, Payload]]] = {}  # link -> (due, sent, payload), in rounds
    newest: dict[tuple[int, int], tuple[int, int, Payload]] = {}  # link -> (received, sent, payload)
    names: dict[int, tuple[Set[Any], int]] = dict.fromkeys(dialogues, (frozenset(), 0))  # agent -> names, first round
    results: dict[int, T] = {}
    for number in range(rounds):
        residuals = {i: residual_of(each, f"agent {i}, round {number}") for i, each in yielded.items()}
        own = {i: as_sent(payload) for i, (payload, _) in yielded.items()}
        stop = bool(after_round and after_round(number, residuals)) or number + 1 == rounds
        current, yielded = yielded, {}
        for i, dialogue in dialogues.items():
            if own[i].keys() != names[i][0]:
                names[i] = own[i].keys(), number
            payloads: dict[int, Payload] = {}
            ages, news, missing = {}, [], []
            for j in fleet[i].neighbours:
                link = waiting.setdefault((j, i), [])
                if (delay := links(j, i, number)) is not None:
                    link.append((number + delay, number, as_received(i, current[j][0], own[j])))
                for message in [each for each in link if each[0] <= number]:
                    link.remove(message)
                    if (j, i) not in newest or message[1] > newest[j, i][1]:
                        newest[j, i] = (number, *message[1:])
                received, sent, payload = newest.get((j, i), (-1, -1, {}))
                if received < number and sent < names[i][1]:
                    missing.append(j)
                    continue
                payloads[j], ages[j] = payload, number - sent
                if received == number:
                    news.append(j)
            inbox = Inbox(own[i], payloads, stop=stop, ages=ages, news=news, missing=tuple(missing))
            try:
                yielded[i] = dialogue.send(inbox)
            except StopIteration as finished:
                results[i] = finished.value
        assert len(results) == (len(dialogues) if stop else 0), (
            f"round {number}: returned {sorted(results)}, stop is {stop}"
        )
        if stop:
            break
    return results


def residual_of(yielded: Any, place: str) -> float:
    """Return the residual that a dialogue yielded.

    Args:
        yielded: What the dialogue yielded: a payload and a residual.
        place: Agent and round, for the message.

    Raises:
        AssertionError: It is something else, or the residual is negative or NaN.
    """
    try:
        _payload, residual = yielded
        number = float(residual)
    except (TypeError, ValueError):
        raise AssertionError(f"{place}: it yielded {yielded!r:.60}; expected a payload and a residual") from None
    assert number >= 0, f"{place}: its residual is {number:g}; expected a number >= 0"
    return number


def as_sent(payload: Payload | PerNeighbour) -> Mapping[Any, Any]:
    """Return a payload as the sender's inbox has it in `own`: canonical; per neighbour, neighbour -> payload."""
    if isinstance(payload, PerNeighbour):
        return {j: canonical(each) for j, each in payload.payloads.items()}
    return canonical(payload)


def as_received(receiver: int, yielded: Payload | PerNeighbour, sent: Mapping[Any, Any]) -> Payload:
    """Return the part of `sent`, which is ``as_sent(yielded)``, that `receiver` receives."""
    payload: Payload = sent[receiver] if isinstance(yielded, PerNeighbour) else sent
    return payload
