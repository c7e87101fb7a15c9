"""The result of a layout: a start and a target for every agent."""

from collections.abc import Callable
from typing import Annotated, NamedTuple, TypeAlias

from pydantic import Field

from dcf_zenoh.plant import Array

Count = Annotated[int, Field(ge=1, le=1000)]
Clear: TypeAlias = Callable[[Array], bool]  # places, shape (k, 2), m -> whether agents can be at all of them


class Places(NamedTuple):
    """Starts and targets of agents, each of shape (agents, 2), in m, in order of ids."""

    starts: Array
    targets: Array
