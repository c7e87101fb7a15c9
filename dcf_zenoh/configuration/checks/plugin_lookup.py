"""Lookup of plug-ins for the checks of a fleet file."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dcf_zenoh.diagnostics import Diagnostics
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins import Plugin, Schema, accepted, check_known, check_signature, is_built_in, load, peek, split
from dcf_zenoh.spec import Kind


@dataclass(frozen=True)
class PluginLookup:
    """Looks up plug-ins, and adds what is wrong with them to the diagnostics.

    Attributes:
        folder: Folder that paths of plug-ins are relative to.
        run: Import plug-ins that are not part of dcf-zenoh. Without it only the text of their files is read.
        diagnostics: Errors, to which new ones are added.
        notes: Remarks for the user, to which new ones are added.
    """

    folder: Path
    run: bool
    diagnostics: Diagnostics
    notes: list[str]

    def check(self, group: str, kind: Kind, key: str, *, used: bool = True) -> None:
        """Check a table that agents cannot override."""
        if schema := self.schema(group, kind.kind, key, used=used):
            self.compare(schema, kind.options, lambda option: f"{key}.{option}")
            self.add_all(schema.missing(kind.options), lambda option: f"{key}.{option}")

    def schema(self, group: str, kind: str, key: str, *, used: bool = True) -> Schema | None:
        """Return the keys that `kind` accepts; None if they cannot be found. Unused foreign kinds are not imported."""
        try:
            if (self.run and used) or is_built_in(group, kind):
                plugin = load(group, kind, self.folder)
                for text in check_signature(group, plugin):
                    self.diagnostics.add(f"{key}.kind", text)
                return accepted(plugin)
            if not self.run:
                self.notes.append(f"{key}: {kind} was not run, so its keys are checked by name at most")
            if split(kind):
                return peek(kind, self.folder)
            check_known(group, kind)
        except PluginError as error:
            self.diagnostics.add(f"{key}.kind", "; ".join(error.problems))
        return None

    def plugin(self, group: str, kind: str) -> Plugin | None:
        """Return the class or function that `kind` names; None if it must not be imported."""
        return load(group, kind, self.folder) if self.run or is_built_in(group, kind) else None

    def compare(self, schema: Schema, options: Mapping[str, Any], key: Callable[[str], str]) -> None:
        """Add an error for each option that `schema` does not accept, under ``key(option)``."""
        self.add_all(schema.convert(options)[1], key)

    def add_all(self, texts: Mapping[str, str], key: Callable[[str], str]) -> None:
        """Add all `texts`, which are option -> error, under ``key(option)``."""
        for option, text in texts.items():
            self.diagnostics.add(key(option), text)
