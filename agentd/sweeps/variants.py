"""Variants of one fleet: what ``--vary KEY=A,B`` stands for, in all combinations."""

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from math import prod
from typing import NamedTuple

from dcf_zenoh.config import LoadedFleet
from dcf_zenoh.configuration.reading.overrides import path_of, value_of, with_plain_id
from dcf_zenoh.errors import ConfigurationError

CHOICES = ("plant", "algorithm")  # names of tables, or kinds, as --plant and --algorithm take them
SHORT = {"topology": "topology.kind", "clock": "time.clock"}  # what --topology and --clock change; so does --seed
_OPENING, _CLOSING, _QUOTES = "[{", "]}", "\"'"


class Variant(NamedTuple):
    """One way to change a fleet.

    Attributes:
        name: ``plant=twin, seed=2``.
        values: What is varied -> the value, as they were written, in order.
    """

    name: str
    values: dict[str, str]

    def choice(self, option: str) -> str | None:
        """The value of ``plant`` or ``algorithm``, if it is varied."""
        return self.values.get(option)

    @property
    def changes(self) -> list[str]:
        """All other values, each as for ``--set``."""
        return [f"{SHORT.get(key, key)}={value}" for key, value in self.values.items() if key not in CHOICES]


def variants(texts: Sequence[str], most: int) -> list[Variant]:
    """All combinations of the values in `texts`; those of the last one change fastest.

    Args:
        texts: Each ``KEY=VALUE,VALUE``: a key of a fleet file, or plant, algorithm, topology, seed or clock, which mean
            the options of these names. Commas in brackets and quotes divide nothing.
        most: How many combinations are allowed.

    Raises:
        ConfigurationError: A text is not of that form, a key or a value is given twice, or there are too many.
    """
    axes: dict[str, list[str]] = {}
    for text in texts:
        key, values = _axis(text)
        if _canonical(key) in map(_canonical, axes):
            raise ConfigurationError(f"--vary {key}: given twice; put all its values into one, with commas")
        axes[key] = values
    sizes = [len(values) for values in axes.values()]
    if prod(sizes) > most:
        raise ConfigurationError(
            f"--vary: {' x '.join(map(str, sizes))} values make {prod(sizes)} variants; at most {most} are allowed"
        )
    chosen = (dict(zip(axes, values, strict=True)) for values in product(*axes.values()))
    return [Variant(", ".join(f"{key}={value}" for key, value in each.items()), each) for each in chosen]


def load_all(variants: Sequence[Variant], load: Callable[[Variant], LoadedFleet]) -> list[LoadedFleet]:
    """The fleet of every variant.

    Raises:
        ConfigurationError: At least one cannot be used. A problem that not all have is told with the variant, or with
            the first of those that have it.
    """
    fleets: list[LoadedFleet] = []
    found: dict[str, list[Variant]] = {}
    source = ""
    for variant in variants:
        try:
            fleets.append(load(variant))
        except ConfigurationError as error:
            source = error.source
            for problem in error.problems:
                found.setdefault(problem, []).append(variant)
    if found:
        raise ConfigurationError(
            [
                problem if len(having) == len(variants) else f"{having[0].name}: {problem}"
                for problem, having in found.items()
            ],
            source,
        )
    return fleets


def _axis(text: str) -> tuple[str, list[str]]:
    """Key and values of ``KEY=VALUE,VALUE``."""
    key, equals, rest = (part.strip() for part in text.partition("="))
    if not (equals and path_of(key)):
        raise ConfigurationError(f"--vary {text}: expected KEY=VALUE,VALUE, such as plant=point,twin")
    values = [value.strip() for value in _split(rest)]
    if not all(values):
        lacking = "a value is missing beside a comma" if any(values) else "no values"
        raise ConfigurationError(f"--vary {text}: {lacking}; expected KEY=VALUE,VALUE, such as plant=point,twin")
    for place, value in enumerate(values):
        if any(_same(value, earlier) for earlier in values[:place]):
            raise ConfigurationError(f"--vary {key}: {value} is given twice; each variant is run once")
    return key, values


def _split(text: str) -> Iterator[str]:
    """The parts between commas that are in no brackets and no quotes."""
    part, depth, quote = "", 0, ""
    for character in text:
        if character == "," and not (depth or quote):
            yield part
            part = ""
            continue
        part += character
        if quote:
            quote = "" if character == quote else quote
        elif character in _QUOTES:
            quote = character
        else:
            depth += (character in _OPENING) - (character in _CLOSING)
    yield part


def _same(one: str, other: str) -> bool:
    """Whether two values are the same in TOML, however they are written."""
    a, b = value_of(one), value_of(other)
    return bool(a == b) and isinstance(a, bool) == isinstance(b, bool)


def _canonical(key: str) -> tuple[str, ...]:
    return with_plain_id(path_of(SHORT.get(key, key)))
