"""A fleet file between text and specification: read, changed from outside, completed; not yet checked."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dcf_zenoh.configuration.reading.fault_shorthand import FaultShorthand, is_fault, list_rules, number_rules
from dcf_zenoh.configuration.reading.fleet_file import find, parse
from dcf_zenoh.configuration.reading.overrides import Overrides, path_of, value_of, with_plain_id
from dcf_zenoh.diagnostics import Diagnostics, listed, nearest, show
from dcf_zenoh.message import BOUNDS
from dcf_zenoh.plugins import known, split
from dcf_zenoh.spec import Topology, default_controller

_DEFAULT_TOPOLOGY = Topology().kind


def read(source: str | Path, *, run_plugins: bool = True) -> "Draft":
    """Read a fleet file.

    Args:
        source: A path, or the name of a built-in fleet.
        run_plugins: Import third-party faults, to find their first keys.

    Raises:
        ConfigurationError: The file does not exist, cannot be read, or is not TOML.
    """
    path = find(source)
    table = parse(path)
    draft = Draft(table, path.absolute().parent, str(path), run_plugins)
    draft.check_ids()
    number_rules(table, draft.diagnostics)
    draft.shorthand.spell_out_all(table)
    return draft


@dataclass
class Draft:
    """The tables of a fleet file, to be changed in place.

    Attributes:
        table: Content of the file.
        folder: Folder that paths of plug-ins are relative to.
        source: Path of the file, for messages.
        run_plugins: Whether third-party plug-ins may be imported.
        notes: Remarks for the user about what is permitted but may surprise.
        diagnostics: Errors.
    """

    table: dict[str, Any]
    folder: Path
    source: str
    run_plugins: bool = True
    notes: list[str] = field(default_factory=list)
    diagnostics: Diagnostics = field(default_factory=Diagnostics)

    def override(self, given: Overrides) -> None:
        """Replace the choices of the file by those given."""
        if given.plant is not None:
            self.choose_plant(given.plant)
        if given.algorithm is not None:
            self.choose_algorithm(given.algorithm)
        values = ((("topology", "kind"), given.topology), (("seed",), given.seed), (("time", "clock"), given.clock))
        for path, value in values:
            if value is not None:
                self.assign(path, value)

    def change(self, text: str) -> None:
        """Apply ``key.path=value``. A value that is not TOML is a string."""
        key, equals, value = text.partition("=")
        path = path_of(key)
        if not (equals and path):
            self.diagnostics.add(text, "expected key.path=value, such as time.duration=10.0")
            return
        self.assign(path, value_of(value.strip()))

    def assign(self, path: Sequence[str], value: Any) -> None:
        """Set one value; missing tables on the path are created. A new kind drops the keys of the old one."""
        path = with_plain_id(path)
        if path[:2] == ("faults", "rule") and len(path) > 2 and not path[2].isdecimal():
            self.diagnostics.add(
                ".".join(path), "cannot be set: rules have numbers, from 1 on in the order of the file"
            )
            return
        table = self.table
        for depth, key in enumerate(path[:-1], 1):
            if is_fault(path[:depth]) and table.get(key) is False:  # switched on again
                del table[key]
            child = table.setdefault(key, {})
            if not isinstance(child, dict):
                self.diagnostics.add(
                    ".".join(path), f"cannot be set: {'.'.join(path[:depth])} is {show(child)}, not a table"
                )
                return
            table = child
        if _names_kind(path) and isinstance(value, str):
            value = self._from_here(value)
            self._drop_options(path[:-1], table, value)
        if value is False and path[-1] in table and is_fault(path) and len(path) == 2:
            del table[path[-1]]  # an absent fault is off; a name that was never there may be misspelt
            return
        table[path[-1]] = value
        if path[0] == "faults":
            number_rules(self.table, self.diagnostics)
            self.shorthand.spell_out_all(self.table)
            for fault, key in self.shorthand.files(self.table, path):
                fault[key] = self._file_from_here(fault[key])

    def choose_plant(self, name: str) -> None:
        """Give all agents the plant [plants.NAME], or one of the kind NAME."""
        plants = self._tables("plants")
        if name not in plants:
            if not self._is_kind("plant", "plants", name, plants):
                return
            self.assign(("plants", name, "kind"), name)
        for agent in self._tables("agents").values():
            agent.pop("plant", None)
        self.table["plant"] = name

    def choose_algorithm(self, name: str) -> None:
        """Replace [algorithm] by [algorithms.NAME], or change its kind to NAME."""
        named = self._tables("algorithms")
        if name not in named:
            if self._is_kind("algorithm", "algorithms", name, named):
                self.assign(("algorithm", "kind"), name)
            return
        old, new = self._tables("").get("algorithm", {}), named[name]
        new.setdefault("kind", name)
        was, dropped = old.get("kind"), [key for key in old if key not in new]
        if dropped:
            how = (
                f"kind changed from {was} to {new['kind']}"
                if was != new["kind"]
                else f"replaced by [algorithms.{name}]"
            )
            self.notes.append(f"algorithm: {how}, dropped {listed(dropped)}")
        self.table["algorithm"] = new  # the same object: changes under either name count

    def complete(self) -> None:
        """Fill in what follows from names: the kinds of named tables, and the only plant as the default."""
        for family in ("plants", "algorithms"):
            for name, table in self._tables(family).items():
                table.setdefault("kind", name)
        plants = self._tables("plants")
        if len(plants) == 1:
            self.table.setdefault("plant", next(iter(plants)))
        if isinstance(controller := self.table.get("controller"), dict):
            flies = "plant" in self.table or any("plant" in own for own in self._tables("agents").values())
            controller.setdefault("kind", default_controller(has_plants=flies))
        self.check_ids()
        self.shorthand.check(self.table, self.diagnostics)
        list_rules(self.table, self.diagnostics)

    def check_ids(self) -> None:
        """Normalise the ids of agents (``01`` is ``1``), and remove keys that are no ids."""
        agents = self.table.get("agents")
        if not isinstance(agents, dict):
            return
        for key in list(agents):
            _, plain = with_plain_id(("agents", key))
            if not (plain.isascii() and plain.isdecimal()):
                self.diagnostics.add(f"agents.{key}", f"the id of an agent is a whole number >= 0, not {key!r}")
                del agents[key]
            elif int(plain) > BOUNDS["sender"].most:
                most = f"{BOUNDS['sender'].most:.0f}"
                self.diagnostics.add(f"agents.{key}", f"the id of an agent is at most {most}, as messages carry it")
                del agents[key]
            elif plain != key:
                if plain in agents:
                    self.diagnostics.add(f"agents.{key}", f"the same agent as agents.{plain}")
                agents[plain] = agents.pop(key)

    @property
    def shorthand(self) -> FaultShorthand:
        """Reader of faults that are written short."""
        return FaultShorthand(self.folder, self.run_plugins)

    def _drop_options(self, path: Sequence[str], table: dict[str, Any], new: str) -> None:
        named = len(path) == 2 or is_fault(path)
        old = table.get("kind", path[-1] if named else _DEFAULT_TOPOLOGY if path == ("topology",) else None)
        if old in (None, new):
            return
        dropped = [
            key for key in table if key not in ("kind", *(Topology.model_fields if path == ("topology",) else ()))
        ]
        for key in dropped:
            del table[key]
        for agent, own in self._tables("agents").items():
            if path == ("problem",) and own.pop("problem", None):
                dropped.append(f"agents.{agent}.problem")
            if path[0] == "plants" and isinstance(own.get("plants"), dict) and own["plants"].pop(path[1], None):
                dropped.append(f"agents.{agent}.plants.{path[1]}")
        if dropped:
            self.notes.append(f"{'.'.join(path)}: kind changed from {old} to {new}, dropped {listed(dropped)}")

    def _from_here(self, kind: str) -> str:
        """Return a kind from outside, its file looked for in the working directory, then next to the fleet file."""
        if in_file := split(kind):
            return f"{self._file_from_here(in_file[0])}:{in_file[1]}"
        return kind

    def _file_from_here(self, file: str) -> str:
        path = Path(file).resolve()
        return str(path) if path.is_file() and path != (self.folder / file).resolve() else file

    def _is_kind(self, key: str, group: str, name: str, tables: dict[str, Any]) -> bool:
        kinds = sorted(known(group))
        if ":" in name or name in kinds:
            return True
        self.diagnostics.add(
            key,
            f"there is no [{group}.{name}] and no kind {name!r}{nearest(name, [*tables, *kinds])}"
            f" tables: {listed(tables)}; known {group}: {listed(kinds)}",
        )
        return False

    def _tables(self, key: str) -> dict[str, dict[str, Any]]:
        """Return the tables in table `key`, or in the file itself; other values are left for validation to refuse."""
        table = self.table.get(key) if key else self.table
        return {name: each for name, each in table.items() if isinstance(each, dict)} if isinstance(table, dict) else {}


def _names_kind(path: Sequence[str]) -> bool:
    plural = path[0] in ("plants", "algorithms") and len(path) == 3
    single = path[0] in ("topology", "problem", "algorithm", "controller") and len(path) == 2
    return path[-1] == "kind" and (plural or single or is_fault(path[:-1]))
