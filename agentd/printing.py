"""Tables that nothing cuts off."""

from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import RenderableType

WIDE = 160  # characters


def print_wide(output: IO[str], *what: "RenderableType") -> None:
    """Print tables and lines: as wide as a terminal is, and where there is none, as wide as they need."""
    from rich.console import Console  # noqa: PLC0415 - for those who print tables, which daemons do not

    console = Console(file=output)
    console = console if console.is_terminal else Console(file=output, width=WIDE)
    console.print(*what, sep="\n", highlight=False)
