"""The contract of an algorithm: a generator that yields payloads and resumes with what the neighbours sent.

``yield payload, residual`` is one communication round, ``return`` the result. When ``inbox.stop`` is set the
iteration is over (agreed by the fleet, out of rounds, or out of time) and the generator returns. The simplest
algorithm is a generator function ``(problem, me, *, options)``; its keyword-only arguments are the keys of its
table in a fleet file.
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
    """A payload of its own for each out-neighbour; all of them must be named, an empty payload is one."""

    payloads: Mapping[int, Payload]


class Inbox(Mapping[int, Payload]):
    """What the neighbours sent in one round: neighbour -> payload, ascending by id.

    A neighbour that was not heard in time is there with the last payload it sent in this step (`fresh` is false),
    or, where there is none or the fleet file says ``missing = "absent"``, not there at all (`missing`). A held
    payload never outlives a change of the payload's names.

    Attributes:
        own: The agent's own payload of this round, as the neighbours receive it.
        payloads: Neighbour -> payload: what the mapping shows.
        stop: The iteration is over: return the result.
        missing: Neighbours with no payload.
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
        """Those of `payloads`: quicker than what a `Mapping` makes of the above."""
        return self.payloads.items()

    def replaced(self, own: Payload, payloads: Mapping[int, Payload]) -> "Inbox":
        """The same inbox with other payloads; a neighbour that is not among them is missing."""
        missing = self.missing
        if len(payloads) < len(self.payloads):
            missing = tuple(sorted({*missing, *(self.payloads.keys() - payloads.keys())}))
        return Inbox(own, payloads, stop=self.stop, ages=self._ages, news=self._news, missing=missing)

    def age(self, neighbour: int) -> int:
        """Rounds since `neighbour` sent what is here; 0 is fresh.

        Raises:
            KeyError: There is nothing of `neighbour`.
        """
        if neighbour not in self.payloads:
            raise KeyError(neighbour)
        return self._ages.get(neighbour, 0)

    def fresh(self, neighbour: int) -> bool:
        """Whether `neighbour` was heard in this very round."""
        return neighbour in self.payloads and not self._ages.get(neighbour, 0)

    def new(self, neighbour: int) -> bool:
        """Whether the payload of `neighbour` was not in an earlier inbox; a late one is new once, too."""
        if self._news is None:
            return self.fresh(neighbour)
        return neighbour in self._news and neighbour in self.payloads


class Result(NamedTuple):
    """What an algorithm found.

    Attributes:
        decision: The agent's own decision, read-only.
        memory: What `Me.recall` gives back in the next control step.
    """

    decision: Array
    memory: Mapping[str, Any] = _NONE


@dataclass
class Me:
    """What an algorithm knows of its own agent.

    Attributes:
        id: Of this agent.
        agents: Ids of the whole fleet, ascending.
        neighbourhood: Whom it hears and who hears it, weights, diameter.
        rng: Random numbers seeded by the fleet's seed and `id`.
        last: The decision of the previous control step; None in the first.
        noted: The latest values given to `note`.
    """

    id: int
    agents: tuple[int, ...]
    neighbourhood: Neighbourhood
    rng: np.random.Generator
    last: Array | None = None
    noted: Mapping[str, Any] = field(default_factory=dict)
    _memory: Mapping[str, Any] = field(default_factory=dict)

    @property
    def neighbours(self) -> tuple[int, ...]:
        """The agents this one hears, ascending."""
        return self.neighbourhood.receives_from

    @property
    def count(self) -> int:
        """Number of agents in the fleet."""
        return len(self.agents)

    def recall(self, name: str, default: Any) -> Any:
        """What the last step's result kept under `name`, or `default`."""
        return self._memory.get(name, default)

    def mix(self, inbox: Inbox, name: str) -> Any:
        """Weighted mean of entry `name` over the neighbours and the agent itself, summed in order of ids.

        The weight of a neighbour with no payload goes to the agent itself, so the weights always sum to 1.

        Raises:
            AlgorithmError: A payload has no such entry, or one of another shape.
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
                    total, first, shape = term, j, getattr(term, "shape", ())
                elif getattr(term, "shape", ()) != shape:  # numpy would stretch one of them
                    raise AlgorithmError(
                        f"the entries {name!r} to mix differ in shape: {shape} from agent {first},"
                        f" {np.shape(term)} from agent {j}"
                    )
                else:
                    total += term  # terms are fresh, so this changes nobody's array
        except KeyError:
            raise AlgorithmError(f"a payload has no entry {name!r} to mix") from None
        return total

    def note(self, **values: Any) -> None:
        """Show values of this round to the log (written with ``log.rounds = true``)."""
        self.noted = values

    def take_notes(self) -> Mapping[str, Any]:
        """What was noted since the last call. The log calls this once a round."""
        noted, self.noted = self.noted, {}
        return noted

    def result(self, decision: npt.ArrayLike, **memory: Any) -> Result:
        """The result to return: this agent's decision, and what to recall in the next step."""
        return Result(read_only(decision), memory)

    def forget(self) -> None:
        """Lose all memory, as in a restart."""
        self.last, self._memory, self.noted = None, {}, {}

    def remember(self, result: Result) -> None:
        """Keep `result` for the next control step."""
        self.last = result.decision
        self._memory = result.memory


T = TypeVar("T")
Dialogue: TypeAlias = Generator[tuple[Payload | PerNeighbour, float], Inbox, T]
Algorithm: TypeAlias = Callable[[Any, Me], Dialogue[Result]]


def solve(algorithm: Algorithm, problem: Any, me: Me) -> Dialogue[Result]:
    """Let `algorithm` solve `problem`, and remember its result for the next control step.

    Raises:
        AlgorithmError: It is no generator, or it returned something else than ``me.result(decision)``.
    """
    dialogue = algorithm(problem, me)
    if not isinstance(dialogue, Generator):
        raise AlgorithmError(f"the algorithm is no generator: it has no yield, and returned {dialogue!r:.60}")
    result = yield from dialogue
    if not isinstance(result, Result):
        raise AlgorithmError(f"the algorithm returned {result!r:.60}; expected me.result(decision)")
    me.remember(result)
    return result
