"""Imports go one way: what a module may import follows from where it is. Nothing is imported here, only read."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
FAMILIES = ("plants", "topologies")
PACKAGES = ("agentd", "dcf_zenoh", *FAMILIES)

# Folders and modules of dcf_zenoh. Each may import from its own row and from those above.
LAYERS = (
    "errors",
    "plant spec graph clock message diagnostics",
    "requests runner messaging layouts",
    "problems faults",
    "algorithms",
    "controllers rounds testing",
    "records",
    "loop",
    "plugins",
    "configuration.building",
    "configuration.reading",
    "configuration config",
    "assembly records.run simulation analysis",
)
# Folder or module of agentd -> what else of agentd it may import. The command line may import all of them.
AGENTD = {
    "fleets": "",
    "exit_codes": "",
    "operator_file": "",
    "run_directory": "",
    "endpoints": "",
    "fault_rules": "",
    "plugin_list": "",
    "figures": "",
    "daemon": "exit_codes",
    "launcher": "daemon exit_codes operator_file run_directory endpoints",
    "operator": "daemon exit_codes operator_file run_directory endpoints fault_rules",
    "results": "figures fault_rules",
    "run_and_report": "launcher results run_directory",
    "sweeps": "launcher results run_and_report run_directory",
}
COMMAND_LINE = ("agentd", "agentd.__main__", "agentd.cli", "agentd.options", "agentd.commands")
FOR_FAMILIES = {"dcf_zenoh.spec", "dcf_zenoh.plant", "dcf_zenoh.graph", "dcf_zenoh.errors"}
WITHOUT_IO = ("algorithms", "problems", "controllers", "faults", "requests", "runner", "rounds", "loop")
IO = ("zenoh", "threading", "socket", "logging", "matplotlib", "time")
COMPOSITION = ("messaging.network", "config", "configuration", "plugins")


@cache
def modules() -> dict[str, Path]:
    """All modules of the project, by name."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def tree(module: str) -> ast.Module:
    return ast.parse(modules()[module].read_text(encoding="utf-8"))


@cache
def imports(module: str) -> frozenset[str]:
    """What the text of a module names anywhere: modules of ours, and packages of others."""
    return frozenset(name for node in ast.walk(tree(module)) for name in named(node))


@cache
def imported(module: str) -> frozenset[str]:
    """What importing a module imports first: what it names outside of functions, with the packages that it is in.

    The package of the whole core does not count: its ``__init__`` is a list of what users need.
    """
    names = {name for node in at_import(tree(module)) for name in named(node)}
    around = {package for name in names for package in packages(name)}
    return frozenset(names | around - {module, *packages(module)})


def named(node: ast.AST) -> set[str]:
    """What an import statement imports."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    if not isinstance(node, ast.ImportFrom):
        return set()
    assert node.level == 0, f"line {node.lineno}: relative import"
    names = {f"{node.module}.{alias.name}" for alias in node.names}
    found = names & modules().keys()  # from package import module
    return found if found == names else {*found, str(node.module)}


def at_import(node: ast.AST) -> list[ast.AST]:
    """All nodes below that run when the module is imported: not in functions, and not for type checkers alone."""
    found: list[ast.AST] = []
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            found += [each for part in child.orelse for each in (part, *at_import(part))]
        elif not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            found += [child, *at_import(child)]
    return found


def packages(name: str) -> list[str]:
    """The packages of ours that a module is in, but ``dcf_zenoh``."""
    parts = name.split(".")
    inside = [".".join(parts[:end]) for end in range(1, len(parts))]
    return [each for each in inside if each in modules() and each != "dcf_zenoh"]


def reached(start: str) -> dict[str, str]:
    """All that comes with importing `start` -> the module that imports it."""
    found = {start: ""}
    queue = [start]
    while queue:
        module = queue.pop()
        for each in sorted(imported(module)) if module in modules() else ():
            if each not in found:
                found[each] = module
                queue.append(each)
    return found


def within(name: str, package: str) -> bool:
    return f"{name}.".startswith(f"{package}.")


def core(*names: str) -> list[str]:
    """The modules of the core that `names` stand for, without names all."""
    return [
        each
        for each in modules()
        if within(each, "dcf_zenoh") and (not names or any(within(each, f"dcf_zenoh.{name}") for name in names))
    ]  # fmt: skip


def below(package: str) -> list[str]:
    """All modules of a package, with the package itself."""
    return [each for each in modules() if within(each, package)]


def layer(module: str) -> int:
    """The row of `LAYERS` that names the module, or else a package it is in; the last one for the core itself."""
    if module == "dcf_zenoh":
        return len(LAYERS)
    local = module.removeprefix("dcf_zenoh.")
    rows = [(len(name), row) for row, names in enumerate(LAYERS) for name in names.split() if within(local, name)]
    assert rows, f"{module} is in no row of LAYERS, which say who may import whom"
    return max(rows)[1]


def circle(needs: dict[str, frozenset[str]]) -> set[str]:
    """Modules that cannot be imported before one another."""
    left = dict(needs)
    while done := [module for module, asked in left.items() if not asked & left.keys()]:
        for module in done:
            del left[module]
    return set(left)


def test_imports_are_told_by_when_they_run() -> None:
    text = (
        "import a\ntry:\n    import b\nexcept ImportError:\n    pass\nclass C:\n    import c\n"
        "def f():\n    import late\nif TYPE_CHECKING:\n    import never\nelse:\n    import d"
    )
    assert [name for node in at_import(ast.parse(text)) for name in named(node)] == ["a", "b", "c", "d"]


def test_module_is_told_from_what_is_in_a_module() -> None:
    (node,) = ast.parse("from dcf_zenoh.plugins import load, schema").body
    assert named(node) == {"dcf_zenoh.plugins", "dcf_zenoh.plugins.schema"}


def test_core_knows_nothing_of_what_is_built_on_it() -> None:
    for module in core():
        for each in imports(module):
            assert each.partition(".")[0] not in ("agentd", *FAMILIES), f"{module} imports {each}"


def test_core_imports_only_from_rows_above() -> None:
    for module in core():
        for each in imports(module):
            if within(each, "dcf_zenoh"):
                assert layer(each) <= layer(module), f"{module} imports {each}, which is in a row below"


def test_imports_make_no_circle() -> None:
    needs = {module: imported(module) for module in modules()}
    assert len(needs) > 30
    assert circle(needs) == set()
    assert circle({**needs, "dcf_zenoh.errors": frozenset({"dcf_zenoh.rounds.exchange"})}) > {
        "dcf_zenoh.rounds.exchange"
    }


def test_folders_of_agentd_import_only_what_their_row_names() -> None:
    for module in set(below("agentd")) - {*COMMAND_LINE}:
        name = module.split(".")[1]
        assert name in AGENTD, f"{module} is in no row of AGENTD, which says who may import whom"
        allowed = [f"agentd.{each}" for each in (name, *AGENTD[name].split())]
        for each in imports(module):
            if within(each, "agentd"):
                assert any(within(each, part) for part in allowed), f"{module} imports {each}"


def test_plants_and_topologies_know_only_the_interface() -> None:
    for family in FAMILIES:
        for module in below(family):
            for each in imports(module):
                ours = each.partition(".")[0] in PACKAGES and not within(each, family)
                assert not ours or each in FOR_FAMILIES, f"{module} imports {each}"


def test_algorithms_and_the_agent_do_no_io() -> None:
    for module in core(*WITHOUT_IO):
        for each, by in [*((each, module) for each in imports(module)), *reached(module).items()]:
            forbidden = each.partition(".")[0] in IO or any(within(each, f"dcf_zenoh.{name}") for name in COMPOSITION)
            assert not forbidden, f"{module} imports {each}, by {by}"


def test_core_and_daemon_start_without_matplotlib() -> None:
    for module in [*core(), "agentd.__main__", "agentd.daemon.daemon", "agentd.daemon.runner"]:
        for each, by in reached(module).items():
            assert not within(each, "matplotlib"), f"{module} imports {each}, by {by}"
    assert "matplotlib.figure" in reached("agentd.figures")
