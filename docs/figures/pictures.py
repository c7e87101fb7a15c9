"""What the scripts in this folder share: they draw what is named on the command line, or all, into docs/images."""

import sys
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from PIL import Image

from agentd.figures.style import STYLE

DOCS = Path(__file__).resolve().parents[1]


def draw(family: str, pictures: Mapping[str, Callable[[], Figure]]) -> None:
    """Draw pictures as ``FAMILY_NAME.png``."""
    with plt.rc_context(STYLE):
        for name in sys.argv[1:] or pictures:
            figure = pictures[name]()
            path = DOCS / "images" / f"{family}_{name}.png"
            drawn = BytesIO()
            figure.savefig(drawn, dpi=110, bbox_inches="tight")
            Image.open(drawn).convert("RGB").quantize(256).save(path, optimize=True)
            plt.close(figure)
            print(f"{path.relative_to(DOCS.parent)}: {path.stat().st_size / 1000:.0f} kB")
