"""Where the agents of a fleet start and where they want to be, without a table for each: ``[layout]``."""

from collections.abc import Callable, Mapping

from dcf_zenoh.layouts.circle import circle
from dcf_zenoh.layouts.places import Places
from dcf_zenoh.layouts.scattered import scattered

# Kind -> function; keyword-only parameters are keys of [layout], positional ones any of `rng` and `clear`.
LAYOUTS: Mapping[str, Callable[..., Places]] = {"circle": circle, "random": scattered}
