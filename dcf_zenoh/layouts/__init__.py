"""Layouts: starts and targets of all agents of a fleet, without a table for each agent: ``[layout]``."""

from collections.abc import Callable, Mapping

from dcf_zenoh.layouts.circle import circle
from dcf_zenoh.layouts.places import Places
from dcf_zenoh.layouts.scattered import scattered

# Kind -> function; keyword-only parameters are keys of [layout], positional ones are `rng` or `clear`.
LAYOUTS: Mapping[str, Callable[..., Places]] = {"circle": circle, "random": scattered}
