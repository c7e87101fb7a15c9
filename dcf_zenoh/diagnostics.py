"""Diagnostics of fleet files and their wording: what was expected, what came, what is allowed, the nearest spelling."""

from collections.abc import Callable, Iterable
from dataclasses import is_dataclass
from difflib import get_close_matches
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np

_NAMES = {float: "number", int: "whole number", str: "string", dict: "table"}
_BOUNDS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}  # as annotated_types and pydantic name them


class Diagnostics:
    """Errors of a fleet file, one line for each key; only the first finding for a key is kept."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def __bool__(self) -> bool:
        return bool(self._texts)

    @property
    def lines(self) -> list[str]:
        """Lines ``key: what is wrong``."""
        return [f"{key}: {text}" for key, text in self._texts.items()]

    def add(self, key: str, text: str) -> None:
        """Note `text` under `key`, unless there is a line for it or a key below it already."""
        if not self.within(key):
            self._texts[key] = text

    def within(self, key: str) -> bool:
        """Return whether something is wrong with `key` or a key below it."""
        return any(f"{each}.".startswith(f"{key}.") for each in self._texts)


def nearest(word: str, allowed: Iterable[str]) -> str:
    """Return ``; did you mean 'step'?``, or ``;`` if no allowed spelling is near `word`."""
    found = get_close_matches(word, list(allowed), 1)
    return f"; did you mean {found[0]!r}?" if found else ";"


def listed(words: Iterable[object]) -> str:
    """Return the words with commas; ``none`` if there are none."""
    return ", ".join(map(str, words)) or "none"


def unknown_key(owner: str, key: str, accepted: Iterable[str]) -> str:
    """Return ``trades has no key 'stpe'; did you mean 'step'? accepted: step, relax, dual``."""
    names = list(accepted)
    return f"{owner} has no key {key!r}{nearest(key, names)} accepted: {listed(names)}"


def show(value: object) -> str:
    """Return a value as in a fleet file, cut to 60 characters."""
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def reason(error: BaseException) -> str:
    """Return the text of an error, with its type unless that is ValueError or TypeError."""
    return str(error) if type(error) in (ValueError, TypeError) else f"{type(error).__name__}: {error}"


def is_union(annotation: Any) -> bool:
    """Return whether `annotation` is a choice of types, such as ``float | None``."""
    return get_origin(annotation) in (Union, UnionType)


def expected(annotation: Any, metadata: Iterable[object] = ()) -> str:
    """Return the description of a type in terms of a fleet file, with its bounds: ``a number > 0``."""
    return _alternatives(annotation, metadata, lambda each: _article(_singular(each)))


def type_name(annotation: Any) -> str:
    """Return the same description without articles, for lists of keys: ``number > 0``."""
    return _alternatives(annotation, (), _singular)


def _alternatives(annotation: Any, metadata: Iterable[object], noun: Callable[[Any], str]) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _alternatives(arguments[0], (*arguments[1:], *metadata), noun)
    if is_union(annotation):
        choices = (_alternatives(each, (), noun) for each in arguments if each is not NoneType)
        return " or ".join(dict.fromkeys(choices))
    if origin is Literal:
        return " or ".join(map(show, arguments))
    if annotation is bool:
        return "true or false"
    return noun(annotation) + _bounds(metadata)


def _bounds(metadata: Iterable[object]) -> str:
    flat = [each for item in metadata for each in getattr(item, "metadata", [item])]  # a FieldInfo holds several
    bounds = [f"{sign} {getattr(each, name)}" for each in flat for name, sign in _BOUNDS.items() if hasattr(each, name)]
    patterns = [f"that matches {each.pattern}" for each in flat if getattr(each, "pattern", None)]
    return "".join(f" {text}" for text in bounds + patterns)


def _singular(annotation: Any) -> str:
    if get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    origin, arguments = get_origin(annotation) or annotation, get_args(annotation)
    if annotation in _NAMES:
        return _NAMES[annotation]
    if origin is np.ndarray:
        return "array of numbers"
    if origin is dict or hasattr(annotation, "model_fields") or is_dataclass(annotation):
        return "table"
    if origin in (list, tuple):
        items = [each for each in arguments if each is not Ellipsis]
        size = f"{len(items)} " if origin is tuple and items and Ellipsis not in arguments else ""
        nouns = {_singular(each) for each in items}
        return f"list of {size}{_plural(nouns.pop())}" if len(nouns) == 1 else "list"
    if annotation is Any:
        return "value"
    return f"value of type {getattr(annotation, '__name__', annotation)}"


def _plural(noun: str) -> str:
    head, of, rest = noun.partition(" of ")
    return f"{head}s{of}{rest}"


def _article(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"
