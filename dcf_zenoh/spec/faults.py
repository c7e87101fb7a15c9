"""Faults of links and of agents, in the shape of the fleet file."""

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from dcf_zenoh.spec.table import AgentId, Kind, NonNegativeFloat, PositiveFloat, Table


class FaultTable(Kind):
    """One fault: `kind` and its keys."""


Switch = FaultTable | Literal[False]  # False switches a fault off
Ids = AgentId | tuple[AgentId, ...]


class FaultRule(Table):
    """Faults of some links, or at some time; all other keys are faults by name, `false` for no fault."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False, populate_by_name=True)
    __pydantic_extra__: dict[str, Switch] = Field(init=False)

    from_: Ids | None = Field(default=None, alias="from", description="sending agents; none: all")
    to: Ids | None = Field(default=None, description="receiving agents; none: all")
    during: tuple[NonNegativeFloat, NonNegativeFloat] | None = Field(
        default=None, description="begin and end of the instants at which messages enter the link, s; none: always"
    )

    @property
    def faults(self) -> dict[str, Switch]:
        """Name -> fault."""
        return dict(self.model_extra or {})

    def covers(self, sender: int, receiver: int) -> bool:
        """Return whether the rule applies to the link ``sender -> receiver``."""
        return _among(sender, self.from_) and _among(receiver, self.to)


def _among(agent: int, ids: Ids | None) -> bool:
    return ids is None or agent == ids or (isinstance(ids, tuple) and agent in ids)


class Faults(Table):
    """Faults of all links, by name, and rules; later rules win, name by name."""

    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False, populate_by_name=True)
    __pydantic_extra__: dict[str, Switch] = Field(init=False)

    rule: tuple[FaultRule, ...] = Field(default=(), description="[[faults.rule]], faults of some links or at some time")

    @property
    def everywhere(self) -> dict[str, Switch]:
        """Name -> fault of all links."""
        return dict(self.model_extra or {})

    @property
    def rules(self) -> tuple[FaultRule, ...]:
        """All rules, beginning with the one for all links and times."""
        return (FaultRule.model_validate(self.everywhere), *self.rule)


class Crash(Table):
    """Crash of an agent, perhaps with a restart."""

    at: NonNegativeFloat = Field(description="s")
    restart_after: PositiveFloat | None = Field(default=None, description="s; none: it stays dead")


class Slow(Table):
    """Slow-down of the computation of an agent."""

    factor: Annotated[float, Field(ge=1)] = Field(description="by which its computation takes longer")
    during: tuple[NonNegativeFloat, NonNegativeFloat] | None = Field(default=None, description="s; none: always")


class AgentFaults(Table):
    """Faults of one agent; false if there are none."""

    crash: Crash | None = None
    pause: tuple[NonNegativeFloat, NonNegativeFloat] | None = Field(
        default=None, description="begin and end of a time in which the agent does nothing, s"
    )
    slow: Slow | None = None

    def __bool__(self) -> bool:
        return any(each is not None for each in (self.crash, self.pause, self.slow))
