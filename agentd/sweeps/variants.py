"""Variants of one fleet: all combinations of the values of ``--vary KEY=A,B``."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from math import prod
from typing import NamedTuple

from dcf_zenoh.config import LoadedFleet, Overrides
from dcf_zenoh.config import load as load_fleet_file
from dcf_zenoh.configuration.reading.overrides import path_of, value_of, with_plain_id
from dcf_zenoh.errors import ConfigurationError

CHOICES = ("plant", "algorithm")  # names of tables, or kinds, as for --plant and --algorithm
KEY_OF_OPTION = {"topology": "topology.kind", "clock": "time.clock"}  # --seed has the name of its key
_OPENING, _CLOSING, _QUOTES = "[{", "]}", "\"'"


class Variant(NamedTuple):
    """One variant of a fleet.

    Attributes:
        name: Name such as ``plant=twin, seed=2``.
        values: Varied key -> value, both as on the command line, in order.
    """

    name: str
    values: dict[str, str]

    def choice(self, option: str) -> str | None:
        """Return the value of ``plant`` or ``algorithm``; None if it is not varied."""
        return self.values.get(option)

    @property
    def changes(self) -> list[str]:
        """All other values, each in the form ``key=value`` of ``--set``."""
        return [f"{KEY_OF_OPTION.get(key, key)}={value}" for key, value in self.values.items() if key not in CHOICES]


class VariedFleet(NamedTuple):
    """The fleet that is varied, as the command line gives it. It can be pickled.

    Attributes:
        source: Fleet file, or name of a built-in fleet.
        overrides: Choices for what is not varied.
        changes: Values of ``--set``.
    """

    source: str
    overrides: Overrides
    changes: tuple[str, ...]

    def load(self, variant: Variant, *, clock: str | None, seed: int | None) -> LoadedFleet:
        """Load a variant of the fleet.

        Args:
            variant: Variant to load; it takes precedence over all other choices.
            clock: Clock of the variant; None for that of the fleet file.
            seed: Seed of the variant; None for that of the fleet file.

        Raises:
            ConfigurationError: The variant cannot be used.
        """
        overrides = replace(
            self.overrides,
            clock=clock,
            seed=seed,
            plant=variant.choice("plant") or self.overrides.plant,
            algorithm=variant.choice("algorithm") or self.overrides.algorithm,
        )
        return load_fleet_file(self.source, overrides, changes=[*self.changes, *variant.changes])


def variants(texts: Sequence[str], limit: int) -> list[Variant]:
    """Return all combinations of values; the values of the last text change fastest.

    Args:
        texts: Texts of the form ``KEY=VALUE,VALUE``. A key is one of a fleet file, or plant, algorithm, topology, seed
            or clock, which stand for the options of these names. Commas within brackets and quotes do not separate.
        limit: Maximum number of combinations.

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
    if prod(sizes) > limit:
        raise ConfigurationError(
            f"--vary: {' x '.join(map(str, sizes))} values make {prod(sizes)} variants; at most {limit} are allowed"
        )
    chosen = (dict(zip(axes, values, strict=True)) for values in product(*axes.values()))
    return [Variant(", ".join(f"{key}={value}" for key, value in each.items()), each) for each in chosen]


def load_all(variants: Sequence[Variant], load: Callable[[Variant], LoadedFleet]) -> list[LoadedFleet]:
    """Load the fleet of every variant.

    Args:
        variants: Variants to load.
        load: Loads the fleet of a variant.

    Raises:
        ConfigurationError: At least one fleet cannot be used. The problems of all variants are collected; a problem
            that not all variants have is prefixed with the name of the first variant that has it.
    """
    fleets: list[LoadedFleet] = []
    variants_with: dict[str, list[Variant]] = {}  # problem -> variants that have it
    source = ""
    for variant in variants:
        try:
            fleets.append(load(variant))
        except ConfigurationError as error:
            source = error.source
            for problem in error.problems:
                variants_with.setdefault(problem, []).append(variant)
    if variants_with:
        raise ConfigurationError(
            [
                problem if len(affected) == len(variants) else f"{affected[0].name}: {problem}"
                for problem, affected in variants_with.items()
            ],
            source,
        )
    return fleets


def _axis(text: str) -> tuple[str, list[str]]:
    """Parse the key and the values of ``KEY=VALUE,VALUE``."""
    key, equals, rest = (part.strip() for part in text.partition("="))
    if not (equals and path_of(key)):
        raise ConfigurationError(f"--vary {text}: expected KEY=VALUE,VALUE, such as plant=point,twin")
    values = [value.strip() for value in _split(rest)]
    if not all(values):
        missing = "a value is missing beside a comma" if any(values) else "no values"
        raise ConfigurationError(f"--vary {text}: {missing}; expected KEY=VALUE,VALUE, such as plant=point,twin")
    for place, value in enumerate(values):
        if any(_equal(value, earlier) for earlier in values[:place]):
            raise ConfigurationError(f"--vary {key}: {value} is given twice; each variant is run once")
    return key, values


def _split(text: str) -> Iterator[str]:
    """Yield the parts between commas outside of brackets and quotes."""
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


def _equal(one: str, other: str) -> bool:
    """Return whether two texts are the same value in TOML."""
    a, b = value_of(one), value_of(other)
    return bool(a == b) and isinstance(a, bool) == isinstance(b, bool)


def _canonical(key: str) -> tuple[str, ...]:
    """Return the path in a fleet file, by which two spellings of a key are compared."""
    return with_plain_id(path_of(KEY_OF_OPTION.get(key, key)))
