"""Plug-ins in files: imported once, or read as text without running them."""

import ast
import hashlib
import importlib.abc
import importlib.util
import json
import sys
import traceback
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias, cast

from dcf_zenoh.diagnostics import listed, nearest, reason
from dcf_zenoh.errors import PluginError
from dcf_zenoh.plugins.schema import REQUIRED, Parameter, Schema

_Definitions: TypeAlias = Mapping[str, ast.ClassDef | ast.FunctionDef]


def split(kind: str) -> tuple[str, str] | None:
    """Return file and name of a kind such as ``./file.py:Name``; None for other kinds."""
    file, _, name = kind.rpartition(":")
    return (file, name) if file.endswith(".py") else None


def import_file(path: Path, kind: str) -> ModuleType:
    """Import a file, once for each path and content.

    Args:
        path: The file.
        kind: Kind that is in the file, for messages.

    Raises:
        PluginError: The file cannot be read, or raises an exception.
    """
    content = _read(path, kind)
    path = path.resolve()
    digest = hashlib.sha256(bytes(path) + b"\0" + content).hexdigest()[:16]
    name = f"dcf_zenoh_plugin_{path.stem}_{digest}"
    if name in sys.modules:
        return sys.modules[name]
    _check_copy(path, content, kind)
    loader = _Source(Path(original(path)), content)
    spec = importlib.util.spec_from_file_location(name, path, loader=loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses and annotations look up their module there
    try:
        loader.exec_module(module)
    except (Exception, SystemExit) as error:  # a script may exit
        del sys.modules[name]
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == loader.get_filename(name)]
        at = f", line {lines[-1]}" if lines else ""
        raise PluginError(f"{kind}: importing {path}{at} failed: {reason(error)}") from error
    return module


def original(path: Path) -> str:
    """Return the file that a plug-in in a run directory is a copy of, if that is unchanged; else `path` itself."""
    try:
        sources = json.loads((path.parents[1] / "sources.json").read_text(encoding="utf-8"))
        source = Path(sources[f"{path.parent.name}/{path.name}"])
        return str(source if source.read_bytes() == path.read_bytes() else path)
    except (OSError, ValueError, LookupError, TypeError):
        return str(path)


def _check_copy(path: Path, content: bytes, kind: str) -> None:
    """Refuse a plug-in in a run directory that is not the one with which the run was started.

    Raises:
        PluginError: It has another SHA-256.
    """
    try:
        digests = json.loads((path.parents[1] / "plugins.json").read_text(encoding="utf-8"))
        expected = digests[f"{path.parent.name}/{path.name}"]
    except (OSError, ValueError, LookupError, TypeError):
        return  # not in a run directory
    if hashlib.sha256(content).hexdigest() != expected:
        raise PluginError(f"{kind}: {path} was changed after the run began: its SHA-256 is not that of plugins.json")


def peek(kind: str, folder: Path) -> Schema | None:
    """Return the keys of a plug-in in a file, read from its text: nothing of it runs.

    Types are not resolved. The keys of a sub-table are known if its dataclass is defined in the same file and has no
    base class. None if the keys of the plug-in cannot be read from the text: of a class without a constructor of its
    own, or a name that is imported or assigned.

    Raises:
        PluginError: The file cannot be read, is not Python, or defines nothing of that name.
    """
    file, name = split(kind) or ("", "")
    path = folder / file
    try:
        tree = ast.parse(_read(path, kind), str(path))
    except (SyntaxError, ValueError) as error:
        raise PluginError(f"{kind}: {path} is not Python: {reason(error)}") from error
    defined = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    if name not in defined:
        if name in _bound(tree):
            return None
        raise PluginError(f"{kind}: {path} has no {name!r}{nearest(name, defined)} it defines: {listed(defined)}")
    node: ast.stmt = defined[name]
    if isinstance(node, ast.ClassDef):
        constructors = [each for each in node.body if isinstance(each, ast.FunctionDef) and each.name == "__init__"]
        if not constructors:
            return None
        node = constructors[0]
    arguments = cast(ast.FunctionDef, node).args
    pairs = zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
    return Schema(name, tuple(_parameter(arg.arg, arg.annotation, default, defined) for arg, default in pairs))


def _parameter(name: str, annotation: ast.expr | None, default: ast.expr | None, defined: _Definitions) -> Parameter:
    """Return a key without its type, and the keys of its sub-table if the annotation names a dataclass of the file."""
    node = defined.get(_text(annotation))
    if (
        not isinstance(node, ast.ClassDef)
        or node.bases
        or not any("dataclass" in _text(d) for d in node.decorator_list)
    ):
        return Parameter(name, Any, default or REQUIRED)
    keys = [
        _parameter(each.target.id, each.annotation, each.value or default, defined)
        for each in node.body
        if isinstance(each, ast.AnnAssign)
        and isinstance(each.target, ast.Name)
        and "ClassVar" not in _text(each.annotation)
        and "init=False" not in _text(each.value)
    ]
    return Parameter(name, Any, default or REQUIRED, Schema(name, tuple(keys)))


def _text(node: ast.expr | None) -> str:
    """Return an annotation or a decorator as text, without the quotes of one that is a string."""
    return ast.unparse(node).strip("'") if node else ""


def _bound(tree: ast.Module) -> set[str]:
    """Return the names that are assigned, imported or defined anywhere in the file."""
    names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    aliases = [
        alias for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom) for alias in node.names
    ]
    nested = {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    return names | nested | {alias.asname or alias.name for alias in aliases}


class _Source(importlib.abc.SourceLoader):
    """Loader of bytes that were read before: what runs is what was hashed, and no ``__pycache__`` is left behind."""

    def __init__(self, path: Path, content: bytes) -> None:
        self._path = str(path)
        self._content = content

    def get_filename(self, fullname: str) -> str:  # noqa: ARG002
        return self._path

    def get_data(self, path: str) -> bytes:  # noqa: ARG002
        return self._content


def _read(path: Path, kind: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise PluginError(f"{kind}: cannot read {path}: {error.strerror}") from error
