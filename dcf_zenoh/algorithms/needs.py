"""Preconditions of an algorithm on its problem, the graph and its options, declared by a decorator.

`agentd check` evaluates them as far as it can without a run. What depends on the numbers of a problem is checked when
the algorithm is called. An algorithm without the decorator is not restricted.
"""

import functools
import math
import typing
from collections.abc import Callable, Iterator
from dataclasses import dataclass, is_dataclass
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, cast

from pydantic import Field

from dcf_zenoh.algorithms.algorithm import Me, without_misshapen
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.graph import Neighbourhood
from dcf_zenoh.problems.problem import Problem

Fraction = Annotated[float, Field(gt=0, le=1)]
Count = Annotated[int, Field(ge=1)]
F = TypeVar("F", bound=Callable[..., Any])
Links = Literal["directed", "undirected", "complete"]

TRAITS = {
    "smooth": "a cost with a gradient everywhere",
    "strongly_convex": "a strongly convex cost",
    "unconstrained": "a decision without bounds",
    "uncoupled": "a game without shared constraints",
    "linear": "shared constraints that are linear",
    "equality": "shared constraints that are equations",
}


@dataclass(frozen=True)
class Needs:
    """Preconditions of one algorithm.

    Attributes:
        algorithm: Name of the algorithm, for messages.
        structures: Structures of problems that it solves; one of them is enough.
        traits: Attributes of the problem that must be true, keys of `TRAITS`.
        links: Graphs that it accepts: any, those with links in both directions, or those with all links.
        doubly_stochastic: Whether the mixing weights must keep the mean.
        agents: Least number of agents.
        alike: Whether payloads have the same names and shapes at all agents. Others are taken for missing.
        uses: Methods of the problem that it calls, where the structure leaves them open.
    """

    algorithm: str
    structures: tuple[type[Problem], ...]
    traits: tuple[str, ...]
    links: Links
    doubly_stochastic: bool
    agents: int
    alike: bool
    uses: tuple[str, ...] = ()

    def of_problem(self, problem: object, name: str) -> str | None:
        """Return why a problem, or every problem of a class, is refused; None if it is not, or if that is unknown.

        An object that derives from no structure passes if it has the methods of one of `structures`.

        Args:
            problem: Problem, or class of problems.
            name: Name of the problem in messages.
        """
        kind = problem if isinstance(problem, type) else type(problem)
        if not issubclass(kind, self.structures):
            wanted = " or ".join(each.STRUCTURE for each in self.structures)
            if issubclass(kind, Problem):
                found = dict.fromkeys(base.STRUCTURE for base in kind.__bases__ if issubclass(base, Problem))
                return f"{self.algorithm} solves {wanted}, and {name} is {' and '.join(found)}"
            missing = min((_missing_names(each, problem, self.uses) for each in self.structures), key=len)
            if missing:
                return f"{self.algorithm} solves {wanted}, and {name} has no {', '.join(missing)}"
        for method in self.uses:
            if any(getattr(kind, method, None) is getattr(each, method, kind) for each in self.structures):
                return f"{self.algorithm} calls {method}(), which {name} has not"
        for trait in self.traits:
            if getattr(problem, trait, True) is False:
                return f"{self.algorithm} needs {TRAITS[trait]}, which {name} has not"
        return None

    def of_links(self, agent: int, neighbourhood: Neighbourhood, count: int) -> str | None:
        """Return why the links of `agent`, one of `count` agents, are refused; None if they are not."""
        senders, receivers = neighbourhood.receives_from, neighbourhood.sends_to
        if count < self.agents:
            return f"{self.algorithm} needs at least {self.agents} agents, not {count}"
        if self.links != "directed" and senders != receivers:
            return (
                f"{self.algorithm} needs links in both directions; agent {agent} hears {list(senders)} and is heard by"
                f" {list(receivers)} (use an undirected topology)"
            )
        if self.links == "complete" and len(senders) < count - 1:
            return (
                f"{self.algorithm} needs every agent to hear all others; agent {agent} hears {list(senders)} of"
                f" {count - 1} (use topology 'complete')"
            )
        return None

    def of_weights(self, neighbourhood: Neighbourhood) -> str | None:
        """Return why the mixing weights are refused; None if they are not."""
        if self.doubly_stochastic and not neighbourhood.doubly_stochastic:
            return (
                f"{self.algorithm} needs doubly stochastic weights; these are not (use an undirected topology with"
                " weights = 'metropolis')"
            )
        return None


def needs(
    *structures: type[Problem],
    traits: tuple[str, ...] = (),
    links: Links = "directed",
    doubly_stochastic: bool = False,
    agents: int = 1,
    alike: bool = False,
    uses: tuple[str, ...] = (),
) -> Callable[[F], F]:
    """Declare the preconditions of an algorithm, and check them when it is called; see `Needs` for the arguments.

    Options whose annotations have bounds, such as `Fraction`, are checked too.

    Raises:
        AlgorithmError: On a call of the algorithm: a precondition does not hold; the message states which.
    """

    def declare(algorithm: F) -> F:
        needed = Needs(algorithm.__name__, structures, traits, links, doubly_stochastic, agents, alike, uses)
        hints = typing.get_type_hints(algorithm, include_extras=True)

        @functools.wraps(algorithm)
        def checked(problem: Any, me: Me, **options: Any) -> Any:
            wrong = (
                needed.of_links(me.id, me.neighbourhood, me.count)
                or needed.of_weights(me.neighbourhood)
                or needed.of_problem(problem, type(problem).__name__)
                or next(
                    filter(None, (_out_of_range(name, value, hints[name]) for name, value in options.items())), None
                )
            )
            if wrong:
                raise AlgorithmError(wrong if wrong.startswith(needed.algorithm) else f"{needed.algorithm}: {wrong}")
            dialogue = algorithm(problem, me, **options)
            return without_misshapen(dialogue, me) if alike else dialogue

        checked.needs = needed  # type: ignore[attr-defined]
        return cast(F, checked)

    return declare


def needs_of(algorithm: object) -> Needs | None:
    """Return the preconditions that an algorithm declares; None if it declares none."""
    found = getattr(algorithm, "needs", None)
    return found if isinstance(found, Needs) else None


def _missing_names(structure: type[Problem], problem: object, uses: tuple[str, ...]) -> list[str]:
    """Return the names of a structure that a problem does not have; of a class, methods only."""
    names = {*getattr(structure, "__abstractmethods__", ()), *uses}
    if not isinstance(problem, type):
        names |= {
            name
            for each in structure.__mro__
            if issubclass(each, Problem)
            for name in each.__annotations__
            if not hasattr(structure, name)
        }
    return sorted(name for name in names if not hasattr(problem, name))


def _out_of_range(name: str, value: object, annotation: Any) -> str | None:
    """Return why the value of an option is refused by the bounds in its annotation; None if it is not.

    Of nested options every field is checked.
    """
    if is_dataclass(value) and not isinstance(value, type):
        hints = typing.get_type_hints(type(value), include_extras=True)
        fields = (_out_of_range(f"{name}.{key}", getattr(value, key), hint) for key, hint in hints.items())
        return next(filter(None, fields), None)
    if not isinstance(value, int | float) or not (bounds := dict(_bounds(annotation))):
        return None
    low, high = bounds.get("gt", bounds.get("ge", -math.inf)), bounds.get("lt", bounds.get("le", math.inf))
    opening, closing = "(" if "gt" in bounds else "[", ")" if "lt" in bounds else "]"
    above = value > low if "gt" in bounds else value >= low
    below = value < high if "lt" in bounds else value <= high
    return None if above and below else f"{name} must be in {opening}{low:g}, {high:g}{closing}, not {value:g}"


def _bounds(annotation: Any) -> Iterator[tuple[str, float]]:
    """Yield the bounds in a type, named as in pydantic: ("gt", 0.0)."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in (Union, UnionType):
        for each in arguments:
            yield from _bounds(each)
    elif origin is Annotated:
        for item in arguments[1:]:
            for each in getattr(item, "metadata", [item]):  # a FieldInfo holds several
                yield from ((key, getattr(each, key)) for key in ("gt", "ge", "lt", "le") if hasattr(each, key))
