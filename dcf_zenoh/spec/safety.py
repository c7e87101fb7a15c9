"""Safety rules: limits, and the reaction when one is violated."""

from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from dcf_zenoh.spec.table import PositiveFloat, Table, Vector

# log: record it. hold: come to rest, and stay until the end of the run. land: end the flight.
# stop: motors off at once, and end the flight.
Reaction: TypeAlias = Literal["log", "hold", "land", "stop"]
LimitReaction: TypeAlias = Literal["clip", "log", "hold", "land", "stop"]


class Arena(Table):
    """Box in which agents may be, in the world frame."""

    min: Vector = Field(description="least coordinates, m")
    max: Vector = Field(description="greatest coordinates, m")


class SilenceRule(Table):
    """Reaction when a neighbour is lost."""

    after: PositiveFloat = Field(default=0.6, description="s without a message that make a neighbour lost")
    then: Literal["land", "hold", "stop", "continue"] = Field(
        default="land",
        description="end the flight; come to rest and stay until the run's end; motors off; or go on without it",
    )


class LimitRule(Table):
    """Largest permitted magnitude, and the reaction when it is exceeded."""

    max: PositiveFloat = Field(description="greatest magnitude, m/s or m/s²")
    then: LimitReaction = Field(default="clip", description="clip: cut down what is commanded")


class SeparationRule(Table):
    """Separation from each neighbour, by the positions that both sensed, and the reaction to less."""

    min: PositiveFloat | None = Field(
        default=None, description="least distance, m; none: outside of the safety region of the problem, if it has one"
    )
    then: Literal["ignore", "log", "hold", "land", "stop"] = Field(
        default="log", description="ignore: positions are not sent either"
    )


class LateRule(Table):
    """Reaction when several steps in a row are late."""

    in_a_row: Annotated[int, Field(ge=1)] = 3
    then: Reaction = "hold"


class Safety(Table):
    """Safety rules of every agent."""

    geofence: Reaction = Field(default="land", description="outside the arena, if there is one")
    neighbour_silent: SilenceRule = Field(default_factory=SilenceRule)
    not_finite: Literal["hold", "land", "stop"] = Field(
        default="land", description="a decision or a setpoint is not a number"
    )
    speed: LimitRule | None = Field(default=None, description="of the body, and of setpoints")
    acceleration: LimitRule | None = Field(default=None, description="of setpoints")
    separation: SeparationRule = Field(default_factory=SeparationRule)
    missed_deadlines: LateRule | None = None
