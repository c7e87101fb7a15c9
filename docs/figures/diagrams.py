"""Render the mermaid diagrams of the documents to docs/images/<page>_<hash>.svg, for the web site.

Needs ``npx`` (Node.js) with network access for mermaid-cli, and Chromium; CHROMIUM names its executable.
"""

import json
import os
import re
import shutil
import subprocess
import tempfile
from hashlib import sha256
from pathlib import Path

DOCS = Path(__file__).parents[1]
MERMAID = re.compile(r"^```mermaid\n(.*?)^```$", re.M | re.S)
MERMAID_CLI = "@mermaid-js/mermaid-cli@11"
LABELS = {"htmlLabels": False}  # plain SVG text: pictures on a page do not show HTML


def main() -> None:
    """Render what has no picture yet, and remove the pictures of diagrams that are gone."""
    wanted = {
        DOCS / f"images/{page.stem}_{sha256(diagram.encode()).hexdigest()[:12]}.svg": diagram
        for page in sorted(DOCS.rglob("*.md"))
        for diagram in MERMAID.findall(page.read_text(encoding="utf-8"))
    }
    for old in {*DOCS.glob("images/*_????????????.svg")} - wanted.keys():
        old.unlink()
    for picture, diagram in wanted.items():
        if not picture.exists():
            render(diagram, picture)
            print(picture)


def render(diagram: str, picture: Path) -> None:
    """Write one diagram as SVG."""
    browser = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "diagram.mmd").write_text(diagram, encoding="utf-8")
        look = {"theme": "neutral", "fontFamily": "sans-serif", **LABELS, "flowchart": LABELS}
        (folder / "look.json").write_text(json.dumps(look), encoding="utf-8")
        (folder / "browser.json").write_text(json.dumps({"executablePath": browser, "args": ["--no-sandbox"]}))
        subprocess.run(
            ["npx", "--yes", "--package", MERMAID_CLI, "mmdc", "--quiet", "--backgroundColor", "white",
             "--input", folder / "diagram.mmd", "--output", picture,
             "--configFile", folder / "look.json", "--puppeteerConfigFile", folder / "browser.json"],
            check=True,
            env={**os.environ, "PUPPETEER_SKIP_DOWNLOAD": "true"},
        )  # fmt: skip


if __name__ == "__main__":
    main()
