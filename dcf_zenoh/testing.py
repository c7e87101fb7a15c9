"""What algorithms, problems, topologies, plants and faults must satisfy, built-in or anybody's; and a fleet in a plain
loop, to drive algorithms.
"""

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence, Set
from copy import deepcopy
from itertools import combinations
from typing import Any, TypeAlias, TypeVar

import numpy as np

from dcf_zenoh.algorithms.algorithm import Algorithm, Dialogue, Inbox, Me, PerNeighbour, Result
from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.graph import WEIGHTS, Graph, Neighbourhood
from dcf_zenoh.messaging.delivery import Delivery
from dcf_zenoh.messaging.message import Last, Message, Payload, canonical
from dcf_zenoh.plant import Plant, Setpoint
from dcf_zenoh.problem_contract import check_problem

__all__ = [
    "Delay",
    "check_algorithm",
    "check_fault",
    "check_plant",
    "check_problem",
    "check_topology",
    "converse",
    "fleet_of",
    "in_time",
    "lockstep",
    "lossy",
]

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
        residuals = {i: _residual(each, f"agent {i}, round {number}") for i, each in said.items()}
        own = {i: _as_sent(payload) for i, (payload, _) in said.items()}
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
                    link.append((number + delay, number, _to(i, spoken[j][0], own[j])))
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


def _residual(said: Any, place: str) -> float:
    """The residual of what was yielded, which must be a payload and a residual."""
    try:
        _payload, residual = said
        number = float(residual)
    except (TypeError, ValueError):
        raise AssertionError(f"{place}: it yielded {said!r:.60}; expected a payload and a residual") from None
    assert number >= 0, f"{place}: its residual is {number:g}; expected a number >= 0"
    return number


def _as_sent(payload: Payload | PerNeighbour) -> Mapping[Any, Any]:
    """What an inbox shows as the agent's own payload: canonical; of edge payloads, neighbour -> payload."""
    if isinstance(payload, PerNeighbour):
        return {j: canonical(each) for j, each in payload.payloads.items()}
    return canonical(payload)


def _to(receiver: int, said: Payload | PerNeighbour, sent: Mapping[Any, Any]) -> Payload:
    """What `receiver` hears of what was sent."""
    payload: Payload = sent[receiver] if isinstance(said, PerNeighbour) else sent
    return payload


def _same(before: Any, after: Any) -> bool:
    """Whether two entries of an own payload are equal: arrays or numbers, or whole edge payloads."""
    if isinstance(before, Mapping):
        return before.keys() == after.keys() and all(_same(value, after[name]) for name, value in before.items())
    return np.array_equal(before, after, equal_nan=True)


def check_algorithm(
    algorithm: Algorithm, problems: Callable[[], Mapping[int, Any]], graph: Graph, *, rounds: int = 6
) -> None:
    """The contract of an algorithm, on one problem and graph.

    It returns a result in the very round in which `inbox.stop` is set, whichever that is and whoever is missing in it;
    it changes nothing it received; its residuals are numbers >= 0 and its decisions finite; and it does the same again
    when everything is the same.

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
    """One round in which some neighbours are missing."""
    running = {i: algorithm(problems[i], me) for i, me in fleet_of(graph).items()}
    said = {i: next(dialogue)[0] for i, dialogue in running.items()}
    sent = {i: _as_sent(payload) for i, payload in said.items()}
    before = {i: _as_sent(payload) for i, payload in said.items()}
    heard = {j: _to(agent, said[j], sent[j]) for j in graph.in_neighbours(agent) if j not in missing}
    place = f"agent {agent}, {list(missing)} missing, stop is {stop}"
    try:
        payload, residual = running[agent].send(Inbox(sent[agent], heard, stop=stop, missing=missing))
    except StopIteration as finished:
        assert stop, f"{place}: it returned without need"
        assert isinstance(finished.value, Result), f"{place}: it returned {finished.value!r:.60}"
    else:
        assert not stop, f"{place}: it went on"
        _residual((payload, residual), place)
        _as_sent(payload)
    for i, values in before.items():
        for name, value in values.items():
            assert _same(value, sent[i][name]), f"{place}: it changed {name!r} of agent {i}"


def check_topology(topology: Callable[[tuple[int, ...]], Iterable[Sequence[int]]], *counts: int) -> None:
    """The contract of a topology: pairs of different agents among those that there are, connected, the same again.

    Args:
        topology: Options bound.
        counts: Numbers of agents to try it with; without any, 1 to 8.

    Raises:
        TopologyError: A pair is none, names an agent that is not there, or there is no way from one agent to another.
        AssertionError: It breaks the contract in another way; the message says how.
    """
    for count in counts or range(1, 9):
        agents = tuple(3 * place + 2 for place in range(count))  # ids are any numbers
        links = [tuple(link) for link in topology(agents)]
        assert [tuple(link) for link in topology(agents)] == links, f"{count} agents: it is not repeatable"
        assert Graph.of(agents, links).diameter < count


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


def check_fault(make: Callable[[], Fault], *, messages: int = 200) -> None:
    """The contract of a fault on a link.

    It does the same again when the messages and their random numbers are the same, whatever another instance of it
    sees; it keeps no generator beyond the message that it got it for; what comes out is due at a whole ns, never before
    it entered, and can be sent; and it changes nothing that it received, which is other receivers' message too.

    Args:
        make: Makes a fresh fault of one link, the same each time.
        messages: How many it gets.

    Raises:
        AssertionError: It breaks the contract; the message says how.
    """
    fault, again, elsewhere = make(), make(), make()
    assert isinstance(fault.STAGE, Stage), f"STAGE is {fault.STAGE!r}, expected a member of Stage"
    shared = np.random.Generator(np.random.Philox(0))  # what a link does: one generator, set anew for each message
    for number, delivery in enumerate(_deliveries(messages)):
        place = f"message {number}"
        before = deepcopy(dict(delivery.message.payload))
        outcome = list(fault.apply(delivery, np.random.Generator(np.random.Philox(number))))
        elsewhere.apply(delivery, np.random.Generator(np.random.Philox(messages + number)))
        shared.bit_generator.state = np.random.Philox(number).state
        repeated = list(again.apply(delivery, shared))
        assert _same(before, delivery.message.payload), f"{place}: it changed the payload that it got"
        assert outcome or fault.LOSES, f"{place}: it lost it, although LOSES is False"
        for each in outcome:
            _check_conveyed(each, delivery, place)
        assert len(outcome) == len(repeated), f"{place}: it is not repeatable"
        for one, other in zip(outcome, repeated, strict=True):
            same = one[1:] == other[1:] and _same(one.message.payload, other.message.payload)
            assert same, f"{place}: it is not repeatable"


def _check_conveyed(conveyed: Delivery, delivery: Delivery, place: str) -> None:
    """One of the deliveries that came out for `delivery`."""
    assert isinstance(conveyed, Delivery), f"{place}: it returned {conveyed!r:.60}; expected deliveries"
    due = conveyed.due
    assert type(due) is int, f"{place}: due at {due!r}, expected a whole number of ns"
    assert due >= delivery.entered, f"{place}: due at {due} ns, before it entered at {delivery.entered} ns"
    assert conveyed.entered == delivery.entered, f"{place}: it changed when the message entered"
    assert conveyed.here == delivery.here, f"{place}: it changed where the receiver is"
    canonical(conveyed.message.payload)
    for name, value in conveyed.message.payload.items():
        locked = not isinstance(value, np.ndarray) or not value.flags.writeable
        assert locked, f"{place}: its payload {name!r} can be changed"


def _deliveries(count: int) -> Iterator[Delivery]:
    """Messages of all sorts on one link from agent 1 to agent 2: two phases, goodbyes, pauses and crowds."""
    rng = np.random.default_rng(0)
    entered = 0
    for number in range(count):
        entered += int(rng.choice([0, 1, 1_000_000, 50_000_000]))
        phases: tuple[Payload, ...] = (
            {"x": rng.normal(size=3), "free": rng.random(4) < 0.5, "count": number},
            {"gain": rng.normal(), "map": rng.normal(size=(2, 5)).astype("f4"), "ids": np.arange(number % 7)},
            {},
        )
        payload = canonical(phases[number % 2 if number % 10 else 2])
        there, here = (tuple(rng.uniform(-3, 3, 2).tolist()) if number % 5 else () for _ in range(2))
        message = Message(1, 0, number, number // 4, number % 4, entered, -1, -1, 0, Last.NO, (1.0,), there, payload)
        yield Delivery(message, entered, entered + int(rng.choice([0, 5_000_000])), here)
