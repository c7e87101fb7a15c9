"""Checks of the values of faults' keys, with uniform messages."""

from math import isfinite

LONGEST = 1e8  # s; about three years


def probability(key: str, value: float) -> float:
    """Return `value` if it is a probability.

    Raises:
        ValueError: It is not from 0 to 1.
    """
    if not 0 <= value <= 1:
        raise ValueError(f"{key} must be a probability, from 0 to 1, not {value}")
    return value


def finite(key: str, value: float) -> float:
    """Return `value` if it is finite.

    Raises:
        ValueError: It is not finite.
    """
    if not isfinite(value):
        raise ValueError(f"{key} must be finite, not {value}")
    return value


def at_least(key: str, value: float, least: float, unit: str = "") -> float:
    """Return `value` if it is finite and at least `least`; a value in s must also be at most `LONGEST`.

    Raises:
        ValueError: It is outside this range.
    """
    if not (value >= least and isfinite(value)):
        raise ValueError(f"{key} must be at least {least:g}{_in(unit)}, not {value}")
    _not_endless(key, value, unit)
    return value


def positive(key: str, value: float, unit: str = "") -> float:
    """Return `value` if it is finite and greater than 0; a value in s must also be at most `LONGEST`.

    Raises:
        ValueError: It is outside this range.
    """
    if not (value > 0 and isfinite(value)):
        raise ValueError(f"{key} must be positive{_in(unit)}, not {value}")
    _not_endless(key, value, unit)
    return value


def _not_endless(key: str, value: float, unit: str) -> None:
    if unit == "s" and value > LONGEST:
        raise ValueError(f"{key} must be at most {LONGEST:g}, in s, not {value}")


def _in(unit: str) -> str:
    return f", in {unit}" if unit else ""
