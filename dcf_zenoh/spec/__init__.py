"""The specification of a fleet: one frozen, validated object in the shape of the fleet file.

`dcf_zenoh.config` makes it from a fleet file; all other code only reads it. Durations are in s here, and integer ns
(`nanoseconds`) wherever the project computes with time.
"""

from dcf_zenoh.spec.faults import AgentFaults, Crash, FaultRule, Faults, FaultTable, Slow, Switch
from dcf_zenoh.spec.fleet import (
    Activation,
    AgentSpec,
    AgentTable,
    Arrived,
    FleetSpec,
    Log,
    NetworkTable,
    Rounds,
    Time,
    Topology,
    default_controller,
)
from dcf_zenoh.spec.safety import Arena, LateRule, LimitRule, Reaction, Safety, SeparationRule, SilenceRule
from dcf_zenoh.spec.table import (
    AgentId,
    Kind,
    Name,
    NonNegativeFloat,
    PositiveFloat,
    Table,
    Vector,
    merged,
    nanoseconds,
)

__all__ = [
    "Activation",
    "AgentFaults",
    "AgentId",
    "AgentSpec",
    "AgentTable",
    "Arena",
    "Arrived",
    "Crash",
    "FaultRule",
    "FaultTable",
    "Faults",
    "FleetSpec",
    "Kind",
    "LateRule",
    "LimitRule",
    "Log",
    "Name",
    "NetworkTable",
    "NonNegativeFloat",
    "PositiveFloat",
    "Reaction",
    "Rounds",
    "Safety",
    "SeparationRule",
    "SilenceRule",
    "Slow",
    "Switch",
    "Table",
    "Time",
    "Topology",
    "Vector",
    "default_controller",
    "merged",
    "nanoseconds",
]
