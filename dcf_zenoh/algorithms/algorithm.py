"""Contract of an algorithm: a generator that yields payloads and resumes with the neighbours' payloads.

``inbox = yield payload, residual`` is one communication round. When ``inbox.stop`` is set, the iteration is over
(agreed by the fleet, out of rounds, or out of time) and the generator returns ``me.result(decision)``. The simplest
algorithm is a generator function ``(problem, me, *, options)``; its keyword-only arguments are the keys of
``[algorithm]`` in a fleet file.
"""

from collections.abc import Callable, Collection, Generator, ItemsView, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.message import Payload
from dcf_zenoh.plant import Array, read_only

_NONE: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class PerNeighbour:
    """Separate payloads for the out-neighbours.

    Attributes:
        payloads: Out-neighbour -> payload. Every out-neighbour must have one; it may be empty.
    """

    payloads: Mapping[int, Payload]


class Inbox(Mapping[int, Payload]):
    """Payloads of the in-neighbours in one round: neighbour -> payload, ascending by id.

    If a neighbour's message is not received in time, its last payload of this step stands in, as held value (`fresh` is
    false). If there is none, or the fleet file has ``missing = "absent"``, the neighbour is in `missing` and not in the
    mapping. A held value never outlives a change of the payload's names.

    Args:
        own: The attribute.
        payloads: The attribute.
        stop: The attribute.
        ages: Neighbour -> rounds since it sent its payload; 0 for a neighbour that is not in it.
        news: Neighbours whose payload is in an inbox for the first time; None: those with age 0.
        missing: The attribute.

    Attributes:
        own: The agent's own payload of this round, as the neighbours receive it.
        payloads: Neighbour -> payload; the content of the mapping.
        stop: Whether the iteration is over: return the result.
        missing: In-neighbours without a payload.
    """

    __slots__ = ("_ages", "_news", "missing", "own", "payloads", "stop")

    def __init__(
        self,
        own: Payload,
        payloads: Mapping[int, Payload],
        *,
        stop: bool,
        ages: Mapping[int, int] | None = None,
        news: Collection[int] | None = None,
        missing: tuple[int, ...] = (),
    ) -> None:
        self.own = own
        self.stop = stop
        self.missing = missing
        self.payloads = payloads
        self._ages = ages or {}
        self._news = news

    def __getitem__(self, neighbour: int) -> Payload:
        return self.payloads[neighbour]

    def __iter__(self) -> Iterator[int]:
        return iter(self.payloads)

    def __len__(self) -> int:
        return len(self.payloads)

    def items(self) -> ItemsView[int, Payload]:
        """Return the items of `payloads`; faster than the method inherited from `Mapping`."""
        return self.payloads.items()

    def replaced(self, own: Payload, payloads: Mapping[int, Payload]) -> "Inbox":
        """Return this inbox with other payloads; a neighbour that has none in them is missing."""
        missing = self.missing
        if len(payloads) < len(self.payloads):
            missing = tuple(sorted({*missing, *(self.payloads.keys() - payloads.keys())}))
        return Inbox(own, payloads, stop=self.stop, ages=self._ages, news=self._news, missing=missing)

    def age(self, neighbour: int) -> int:
        """Return how many rounds ago `neighbour` sent its payload; 0 is fresh.

        Raises:
            KeyError: There is no payload of `neighbour`.
        """
        if neighbour not in self.payloads:
            raise KeyError(neighbour)
        return self._ages.get(neighbour, 0)

    def fresh(self, neighbour: int) -> bool:
        """Return whether the payload of `neighbour` was sent in this round."""
        return neighbour in self.payloads and not self._ages.get(neighbour, 0)

    def new(self, neighbour: int) -> bool:
        """Return whether the payload of `neighbour` is in an inbox for the first time; a late one is new once, too."""
        if self._news is None:
            return self.fresh(neighbour)
        return neighbour in self._news and neighbour in self.payloads


class Result(NamedTuple):
    """Result of an algorithm in one control step.

    Attributes:
        decision: Decision of this agent, shape (n,), read-only.
        memory: Values that `Me.recall` returns in the next control step, by name.
    """

    decision: Array
    memory: Mapping[str, Any] = _NONE


@dataclass
class Me:
    """An algorithm's view of its own agent.

    Attributes:
        id: Id of this agent.
        agents: Ids of the whole fleet, ascending.
        neighbourhood: In- and out-neighbours, mixing weights, diameter of the graph.
        rng: Random numbers, seeded by the fleet's seed and `id`.
        last: Decision of the previous control step; None in the first.
        noted: Latest values given to `note`.
        misshapen: Neighbour -> what was wrong with its last payload that `without_misshapen` took for missing.
        tolerant: A problem without a solution is solved with the least violation of its shared constraints, and is
            no error.
        violated: The algorithm did so in this step.
    """

    id: int
    agents: tuple[int, ...]
    neighbourhood: Neighbourhood
    rng: np.random.Generator
    last: Array | None = None
    noted: Mapping[str, Any] = field(default_factory=dict)
    misshapen: dict[int, str] = field(default_factory=dict)
    tolerant: bool = False
    violated: bool = False
    _memory: Mapping[str, Any] = field(default_factory=dict)

    @property
    def neighbours(self) -> tuple[int, ...]:
        """Ids of the in-neighbours, ascending."""
        return self.neighbourhood.receives_from

    @property
    def count(self) -> int:
        """Number of agents in the fleet."""
        return len(self.agents)

    def recall(self, name: str, default: Any) -> Any:
        """Return what the result of the previous step kept under `name`, or `default`."""
        return self._memory.get(name, default)

    def mix(self, inbox: Inbox, name: str) -> Any:
        """Return the weighted mean of entry `name` over the in-neighbours and the agent itself.

        It is summed in order of ids. The weight of a missing neighbour goes to the agent itself, so the weights always
        sum to 1. A neighbour whose payload has no such entry, or one of another shape, counts as missing, and is kept
        in `misshapen`.

        Raises:
            AlgorithmError: The agent's own payload has no such entry, or several neighbours have the entry and all of
                them in another shape.
        """
        weights, payloads = self.neighbourhood.weights, inbox.payloads
        own_weight = weights[self.id]
        for j in inbox.missing:
            own_weight += weights[j]
        total: Any = None
        try:
            for j, weight in weights.items():
                if j == self.id:
                    term = inbox.own[name] * own_weight
                elif j in payloads:
                    term = payloads[j][name] * weight
                else:
                    continue
                if total is None:
                    total, shape = term, getattr(term, "shape", ())
                elif getattr(term, "shape", ()) != shape:  # numpy would stretch one of them
                    return self._mix_alike(inbox, name)
                else:
                    total += term  # terms are new arrays, so no payload changes
        except KeyError:
            return self._mix_alike(inbox, name)
        return total

    def _mix_alike(self, inbox: Inbox, name: str) -> Any:
        """Mix the entries that have the shape of the agent's own."""
        if name not in inbox.own:
            raise AlgorithmError(f"the agent's own payload has no entry {name!r} to mix")
        wanted = np.shape(inbox.own[name])
        shapes = {j: np.shape(each[name]) if name in each else None for j, each in inbox.payloads.items()}
        wrong = {j: shape for j, shape in shapes.items() if shape != wanted}
        if len(wrong) == len(shapes) > 1 and None not in wrong.values():
            others = ", ".join(f"{shape} from agent {j}" for j, shape in wrong.items())
            raise AlgorithmError(f"the entries {name!r} to mix differ in shape: {wanted} here, {others}")
        for j, shape in wrong.items():
            found = f"no entry {name!r}" if shape is None else f"{name!r} of shape {shape}, expected {wanted}"
            self.misshapen[j] = found
        right = {j: each for j, each in inbox.payloads.items() if j not in wrong}
        return self.mix(inbox.replaced(inbox.own, right), name)

    def note(self, **values: Any) -> None:
        """Note values of this round for the log, which has them if ``log.rounds = true``."""
        self.noted = values

    def take_notes(self) -> Mapping[str, Any]:
        """Return what was noted since the last call. The log calls this once per round."""
        noted, self.noted = self.noted, {}
        return noted

    def take_misshapen(self) -> Mapping[int, str]:
        """Return `misshapen` since the last call. The loop calls this once per step."""
        found, self.misshapen = self.misshapen, {}
        return found

    def result(self, decision: npt.ArrayLike, **memory: Any) -> Result:
        """Return the result of this step: the agent's decision, shape (n,), and what to recall in the next step."""
        return Result(read_only(decision), memory)

    def forget(self) -> None:
        """Clear all memory, as a restart does."""
        self.last, self._memory, self.noted = None, {}, {}

    def remember(self, result: Result) -> None:
        """Keep `result` for the next control step."""
        self.last = result.decision
        self._memory = result.memory


T = TypeVar("T")
Dialogue: TypeAlias = Generator[tuple[Payload | PerNeighbour, float], Inbox, T]
Algorithm: TypeAlias = Callable[[Any, Me], Dialogue[Result]]


def without_misshapen(dialogue: Dialogue[T], me: Me) -> Dialogue[T]:
    """Run a dialogue whose payloads have the same names and shapes at all agents; others are missing in its inboxes.

    An empty payload means nothing and passes. What was wrong is kept in `Me.misshapen`.
    """
    try:
        yielded = next(dialogue)
        while True:
            inbox = yield yielded
            wrong = _misshapen(yielded[0], inbox)
            if wrong:
                me.misshapen.update(wrong)
                right = {j: each for j, each in inbox.payloads.items() if j not in wrong}
                inbox = inbox.replaced(inbox.own, right)
            yielded = dialogue.send(inbox)
    except StopIteration as end:
        result: T = end.value
        return result


def _misshapen(own: Payload | PerNeighbour, inbox: Inbox) -> dict[int, str]:
    """Return neighbour -> what is wrong with its payload, compared with what this agent sends to it."""
    found = {}
    for j, payload in inbox.payloads.items():
        expected = own.payloads.get(j, payload) if isinstance(own, PerNeighbour) else own
        if payload.keys() != expected.keys():
            if payload:
                found[j] = f"names {sorted(payload)}, expected {sorted(expected)}"
            continue
        for name, value in expected.items():
            shape, wanted = getattr(payload[name], "shape", ()), getattr(value, "shape", ())
            if shape != wanted:
                found[j] = f"{name!r} of shape {shape}, expected {wanted}"
    return found


def solve(algorithm: Algorithm, problem: Any, me: Me) -> Dialogue[Result]:
    """Run `algorithm` on `problem` and keep its result in `me` for the next control step.

    Raises:
        AlgorithmError: The algorithm is no generator, or returned something other than ``me.result(decision)``.
    """
    dialogue = algorithm(problem, me)
    if not isinstance(dialogue, Generator):
        raise AlgorithmError(f"the algorithm is no generator: it has no yield, and returned {dialogue!r:.60}")
    result = yield from dialogue
    if not isinstance(result, Result):
        raise AlgorithmError(f"the algorithm returned {result!r:.60}; expected me.result(decision)")
    me.remember(result)
    return result
