"""What a layout is: for every agent a place to start from, and one to go to."""

from collections.abc import Callable
from typing import Annotated, NamedTuple, TypeAlias

from pydantic import Field

from dcf_zenoh.plant import Array

Count = Annotated[int, Field(ge=1, le=1000)]
Clear: TypeAlias = Callable[[Array], bool]  # places, shape (k, 2), m -> whether agents can be there at the same time


class Places(NamedTuple):
    """Where agents start and where they want to be, each of shape (agents, 2), in m, in order of ids."""

    starts: Array
    targets: Array
