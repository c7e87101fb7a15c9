"""Pages of the site that are generated when it is built, so that they cannot go stale.

MkDocs calls the functions ``on_*`` as a hook (mkdocs.yml). They add a page for each group of plug-ins with the keys of
every kind, a page for each Python package, and the documents that are not in this folder.
"""

import hashlib
import posixpath
import re
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from functools import partial
from pathlib import Path
from typing import Any, get_args

from griffe import Docstring, DocstringSectionKind
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError as BuildError
from mkdocs.structure.files import File, Files

from dcf_zenoh.diagnostics import show, type_name
from dcf_zenoh.layouts import LAYOUTS
from dcf_zenoh.plugins import GROUPS, REQUIRED, Parameter, accepted, known, load

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PACKAGES = ("dcf_zenoh", "agentd", "plants", "topologies")
COPIED = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md", "examples/README.md": "examples.md"}
PLACES = {**COPIED, "README.md": "index.md", "examples": "examples.md"}  # where links lead on the site
MERMAID = re.compile(r"^```mermaid\n(.*?)^```$", re.M | re.S)
LINK = re.compile(r"\]\((?!https?:|#|mailto:)([^)#\s]*)((?:#[^)\s]*)?)\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Fill the empty entries of the navigation, and append the documents that it does not list."""
    decisions = sorted(DOCS.glob("decisions/[0-9]*.md"))
    generated = {
        "Kinds and their keys": [f"reference/kinds/{group}.md" for group in groups()],
        "Packages": [{package: f"reference/packages/{package}.md"} for package in packages()],
        "Decisions": ["decisions/README.md", *(f"decisions/{path.name}" for path in decisions)],
    }
    assert config.nav is not None
    for section in config.nav:
        for entries in section.values():
            for entry in entries if isinstance(entries, list) else []:
                if isinstance(entry, dict) and (title := next(iter(entry))) in generated:
                    entry[title] = generated[title]
    listed = set(pages(config.nav))
    documents = [path.relative_to(DOCS).as_posix() for path in sorted(DOCS.rglob("*.md"))]
    config.nav[-1][next(iter(config.nav[-1]))] += [path for path in documents if path not in listed]
    return config


def pages(entries: Any) -> Iterator[str]:
    """Yield the paths in a part of the navigation."""
    if isinstance(entries, str):
        yield entries
    else:
        for each in entries.values() if isinstance(entries, dict) else entries:
            yield from pages(each)


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    for group in groups():
        files.append(File.generated(config, f"reference/kinds/{group}.md", content="\n".join(kinds(group))))
    for package, path in packages().items():
        content = "\n".join(package_page(package, path))
        files.append(File.generated(config, f"reference/packages/{package}.md", content=content))
    for source, target in COPIED.items():
        content = (ROOT / source).read_text(encoding="utf-8")
        content = LINK.sub(partial(redirected, folder=posixpath.dirname(source)), content)
        files.append(File.generated(config, target, content=content))
    return files


def on_page_markdown(markdown: str, *, page: Any, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """Turn links that lead out of the folder of documents inwards, and diagrams into pictures."""
    source = page.file.src_uri
    above = "../" * source.count("/")
    outside = re.compile(rf"\[[^\]]*\]\({re.escape(above)}\.\./[^)]*\)")
    inward = partial(redirected, folder=posixpath.dirname(f"docs/{source}"), above=above)
    markdown = outside.sub(lambda link: LINK.sub(inward, link[0]), markdown)
    markdown = re.sub(r"\[([^\]]*)\]\([./]*outside:[^)]*\)", r"\1", markdown)
    return MERMAID.sub(lambda block: f"![Diagram]({above}{picture(block[1], source)})", markdown)


def redirected(link: re.Match[str], folder: str, above: str = "") -> str:
    """Return the end of a link of a document in `folder` for the site; a file that is not on it is ``outside:``."""
    path = posixpath.normpath(posixpath.join(folder, link[1]))
    place = PLACES.get(path) or (path.removeprefix("docs/") if path.startswith("docs/") else f"outside:{path}")
    return f"]({above}{place}{link[2]})"


def picture(diagram: str, page: str) -> str:
    """Return the path of the picture that docs/figures/diagrams.py rendered from a diagram.

    Raises:
        BuildError: There is none, because the diagram has changed since.
    """
    name = f"images/{Path(page).stem}_{hashlib.sha256(diagram.encode()).hexdigest()[:12]}.svg"
    if not (DOCS / name).exists():
        raise BuildError(f"{page}: a diagram has no picture {name}: run python docs/figures/diagrams.py")
    return name


def packages() -> dict[str, Path]:
    """Return all Python packages of the project by name, those above first."""
    found = {}
    for top in PACKAGES:
        for init in sorted((ROOT / top).rglob("__init__.py")):
            found[".".join(init.parent.relative_to(ROOT).parts)] = init.parent
    return found


def package_page(package: str, path: Path) -> Iterator[str]:
    """Yield the lines of a page that documents the modules of a package."""
    yield f"# {package}\n"
    yield f"::: {package}\n    options:\n      show_root_heading: false\n      show_root_toc_entry: false\n"
    for module in sorted(path.glob("[!_]*.py")):
        yield f"::: {package}.{module.stem}\n"


def groups() -> tuple[str, ...]:
    """Return the groups of kinds: plug-ins, and layouts."""
    return (*GROUPS, "layouts")


def members(group: str) -> dict[str, Callable[..., Any]]:
    """Return the kinds of a group by name."""
    return dict(LAYOUTS) if group == "layouts" else {name: load(group, name, Path()) for name in sorted(known(group))}


def kinds(group: str) -> Iterator[str]:
    """Yield the lines of a page that lists the kinds of a group with their keys."""
    yield f"# {group.capitalize()}\n"
    yield "This page is generated from the code: the keyword-only arguments of a signature are the keys of a kind."
    if group != "layouts":
        yield f"`agentd plugins {group}` prints the keys in a terminal."
    yield ""
    for name, plugin in members(group).items():
        sections = Docstring(plugin.__doc__ or "", lineno=1).parse("google", warnings=False)
        texts = [each.value for each in sections if each.kind is DocstringSectionKind.text]
        yield f"## {name}\n\n`{plugin.__module__}`: {escaped(texts[0]) if texts else ''}\n"
        yield from (f"{escaped(text)}\n" for text in texts[1:])
        described = meanings(plugin)
        rows = [row for key in accepted(plugin).parameters for row in key_rows(key, described)]
        if rows:
            yield "| Key | Type | Default | Meaning |\n|---|---|---|---|"
            yield from rows
            yield ""
        else:
            yield "No keys.\n"
        for section in sections:
            if section.kind is DocstringSectionKind.admonition and section.title == "Source":
                yield f"Source: {escaped(' '.join(section.value.description.split()))}\n"


def meanings(described: object) -> dict[str, str]:
    """Return the descriptions of arguments and fields in the docstring of a function, or of a class and its bases."""
    # the description of an argument replaces that of the attribute of the same name
    kinds = (DocstringSectionKind.attributes, DocstringSectionKind.other_parameters, DocstringSectionKind.parameters)
    found = {}
    for each in reversed(getattr(described, "__mro__", (described,))):
        sections = Docstring(each.__doc__ or "", lineno=1).parse("google", warnings=False)
        for kind in kinds:
            for section in (section for section in sections if section.kind is kind):
                found |= {item.name: " ".join(item.description.split()) for item in section.value}
    return found


def key_rows(key: Parameter, described: dict[str, str], path: str = "") -> Iterator[str]:
    """Yield the row of a key; of a sub-table the rows of its keys."""
    name = f"{path}{key.name}"
    if key.table is not None:
        nested = next(each for each in (key.type, *get_args(key.type)) if is_dataclass(each))
        for each in key.table.parameters:
            yield from key_rows(each, meanings(nested), f"{name}.")
        return
    if key.default is REQUIRED:
        shown = "required"
    elif key.default is None:
        shown = "none"
    else:
        shown = f"`{show(list(key.default) if isinstance(key.default, tuple) else key.default)}`"
    cells = (f"`{name}`", type_name(key.type), shown, described.get(key.name, ""))
    yield f"| {' | '.join(escaped(cell).replace('|', chr(92) + '|') for cell in cells)} |"


def escaped(text: str) -> str:
    """Return a text whose angle brackets are not taken for HTML."""
    return re.sub(r"<(?=[a-zA-Z/])", "&lt;", text)
