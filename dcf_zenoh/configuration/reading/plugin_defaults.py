"""The defaults of plug-ins, added to a specification as if they were in the fleet file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dcf_zenoh.plugins import REQUIRED, Schema, accepted, is_built_in, load
from dcf_zenoh.spec import FaultRule, Faults, FaultTable, FleetSpec, Kind


def with_defaults(spec: FleetSpec, folder: Path, *, run_plugins: bool) -> FleetSpec:
    """Return the same fleet with the defaults of all plug-ins in use but those that TOML cannot express, such as None.

    Faults that are switched off on all links are left out.

    Args:
        spec: A checked fleet.
        folder: Folder that paths of plug-ins are relative to.
        run_plugins: Import plug-ins that are not part of dcf-zenoh. Without it their tables do not change.

    Raises:
        PluginError: A plug-in cannot be loaded.
    """

    def fill(group: str, kind: Kind) -> Kind:
        if not (run_plugins or is_built_in(group, kind.kind)):
            return kind
        return kind.with_options(_completed(accepted(load(group, kind.kind, folder)), kind.options))

    def fill_fault(fault: FaultTable) -> FaultTable:
        if not (run_plugins or is_built_in("faults", fault.kind)):
            return fault
        schema = accepted(load("faults", fault.kind, folder))
        options = _completed(schema, fault.options)
        return FaultTable(
            kind=fault.kind, **{each.name: options[each.name] for each in schema.parameters if each.name in options}
        )

    def rule_with_defaults(rule: FaultRule) -> FaultRule:
        return rule.model_copy(update={name: fault and fill_fault(fault) for name, fault in rule.faults.items()})

    everywhere: dict[str, Any] = {name: fill_fault(fault) for name, fault in spec.faults.everywhere.items() if fault}
    in_use = {own.plant or spec.plant for own in spec.agents.values()}
    return spec.model_copy(
        update={
            "topology": fill("topologies", spec.topology),
            "problem": fill("problems", spec.problem),
            "algorithm": fill("algorithms", spec.algorithm),
            "controller": fill("controllers", spec.controller_kind),
            "plants": {name: fill("plants", kind) if name in in_use else kind for name, kind in spec.plants.items()},
            "faults": Faults(rule=tuple(map(rule_with_defaults, spec.faults.rule)), **everywhere),
        }
    )


def _completed(schema: Schema, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return `options` with the defaults that a fleet file can hold and that the plug-in accepts from one."""
    plain = {each.name: _plain(each.default) for each in schema.parameters if _in_toml(each.default)}
    refused = schema.convert(plain)[1]
    completed = {**{name: value for name, value in plain.items() if name not in refused}, **options}
    for each in schema.parameters:
        given = options.get(each.name, {} if each.default is not REQUIRED and each.default is not None else None)
        if each.table is not None and isinstance(given, Mapping):
            completed[each.name] = _completed(each.table, given)
    return completed


def _in_toml(value: object) -> bool:
    if isinstance(value, tuple | list):
        return all(map(_in_toml, value))
    return isinstance(value, bool | int | float | str)


def _plain(value: Any) -> Any:
    """Return a value with lists in place of tuples, as in a file."""
    return list(map(_plain, value)) if isinstance(value, tuple | list) else value
