"""What must not happen to an agent, and what follows if it does."""

from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from dcf_zenoh.spec.table import PositiveFloat, Table, Vector

# log: note it. hold: come to rest, and stay until the end of the run. land: end the flight.
# stop: motors off at once, and end the flight.
Reaction: TypeAlias = Literal["log", "hold", "land", "stop"]
LimitReaction: TypeAlias = Literal["clip", "log", "hold", "land", "stop"]


class Arena(Table):
    """Where agents may be: a box, in the world frame."""

    min: Vector = Field(description="least coordinates, m")
    max: Vector = Field(description="greatest coordinates, m")


class SilenceRule(Table):
    """What happens when a neighbour is lost."""

    after: PositiveFloat = Field(default=0.6, description="s without a message that make a neighbour lost")
    then: Literal["land", "hold", "stop", "continue"] = Field(
        default="land",
        description="end the flight; come to rest and stay until the run's end; motors off; or go on without it",
    )


class LimitRule(Table):
    """What happens when something is greater than it may be."""

    max: PositiveFloat = Field(description="greatest magnitude, m/s or m/s²")
    then: LimitReaction = Field(default="clip", description="clip: cut down what is commanded")


class SeparationRule(Table):
    """What happens when a neighbour is too near."""

    min: PositiveFloat = Field(description="least distance, m")
    then: Reaction = "log"


class LateRule(Table):
    """What happens when steps overrun one after the other."""

    in_a_row: Annotated[int, Field(ge=1)] = 3
    then: Reaction = "hold"


class Safety(Table):
    """What must not happen, and what follows if it does."""

    geofence: Reaction = Field(default="land", description="outside the arena, if there is one")
    neighbour_silent: SilenceRule = Field(default_factory=SilenceRule)
    not_finite: Literal["hold", "land", "stop"] = Field(
        default="land", description="a decision or a setpoint is not a number"
    )
    speed: LimitRule | None = Field(default=None, description="of the body, and of setpoints")
    acceleration: LimitRule | None = Field(default=None, description="of setpoints")
    separation: SeparationRule | None = Field(default=None, description="to each neighbour, from what it says")
    missed_deadlines: LateRule | None = None
