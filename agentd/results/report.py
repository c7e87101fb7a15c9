"""Report of one run, or of several side by side: figures as PNG and PDF, the flight as GIF."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dcf_zenoh.errors import RecordingError
from dcf_zenoh.records.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dcf_zenoh.analysis.oracle import Oracle


def write_report(runs: Sequence[Run], folder: Path, *, animate: bool = False) -> list[Path]:
    """Draw all figures for which the runs have data; existing ones in `folder` are replaced.

    Args:
        runs: Runs to show side by side, in this order.
        folder: Directory of the files; it is created if needed.
        animate: Also write a GIF of every flight.

    Returns:
        The files written.

    Raises:
        RecordingError: `folder` cannot be written.
    """
    # Imported here, so that daemons do not import matplotlib.
    from matplotlib import rc_context  # noqa: PLC0415

    from agentd.figures import FIGURES  # noqa: PLC0415
    from agentd.figures.flight import write_flight  # noqa: PLC0415
    from agentd.figures.style import STYLE  # noqa: PLC0415

    written: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with rc_context(STYLE):
            for name, draw in FIGURES.items():
                written += _save(draw(runs), folder, name)
            for run, path in zip(runs, _flights(runs, folder), strict=True):
                if animate and write_flight(run, path):
                    written.append(path)
    except OSError as error:
        raise RecordingError(f"{error.filename or folder}: cannot be written: {error.strerror}") from error
    return written


def write_comparison(variants: Mapping[str, Run | str], folder: Path) -> list[Path]:
    """Draw variants of a fleet side by side, as ``comparison.png`` and ``comparison.pdf``.

    Args:
        variants: Name -> run, or the reason why there is none.
        folder: Directory of the files.

    Returns:
        The files written; none if there is nothing to show.

    Raises:
        RecordingError: `folder` cannot be written.
    """
    from agentd.figures.comparison import comparison  # noqa: PLC0415

    return _drawn(lambda: comparison(variants), folder, "comparison")


def write_sweep(rows: Sequence[Mapping[str, Any]], axes: Mapping[str, Sequence[str]], folder: Path) -> list[Path]:
    """Draw a sweep, as ``sweep.png`` and ``sweep.pdf``.

    Args:
        rows: Rows of its table.
        axes: Varied key -> values.
        folder: Directory of the files.

    Returns:
        The files written; none if no varied quantity is a number.

    Raises:
        RecordingError: `folder` cannot be written.
    """
    from agentd.figures.sweep import sweep  # noqa: PLC0415

    return _drawn(lambda: sweep(rows, axes), folder, "sweep")


def write_oracle(runs: Sequence[Run], judged: "Sequence[Oracle]", folder: Path) -> list[Path]:
    """Draw runs and their central solutions, as ``oracle.png`` and ``oracle.pdf``.

    Args:
        runs: Shown side by side.
        judged: Comparison of each run with the central solution.
        folder: Directory of the files.

    Returns:
        The files written; none if no step could be compared.

    Raises:
        RecordingError: `folder` cannot be written.
    """
    from agentd.figures.oracle import oracle  # noqa: PLC0415

    return _drawn(lambda: oracle(runs, judged), folder, "oracle")


def _drawn(draw: "Callable[[], Figure | None]", folder: Path, name: str) -> list[Path]:
    """Draw one figure in the common style, and save it."""
    from matplotlib import rc_context  # noqa: PLC0415

    from agentd.figures.style import STYLE  # noqa: PLC0415

    try:
        with rc_context(STYLE):
            return _save(draw(), folder, name)
    except OSError as error:
        raise RecordingError(f"{error.filename or folder}: cannot be written: {error.strerror}") from error


def _save(figure: "Figure | None", folder: Path, name: str) -> list[Path]:
    if figure is None:
        return []
    paths = [folder / f"{name}.{ending}" for ending in ("png", "pdf")]
    for path in paths:
        figure.savefig(path, bbox_inches="tight")
    return paths


def _flights(runs: Sequence[Run], folder: Path) -> list[Path]:
    """Return one path per run: 'flight.gif', or with the run's name, numbered where two runs have the same name."""
    if len(runs) == 1:
        return [folder / "flight.gif"]
    often = Counter(run.name for run in runs)
    return [
        folder / (f"flight-{run.name}.gif" if often[run.name] == 1 else f"flight-{run.name}-{number}.gif")
        for number, run in enumerate(runs, start=1)
    ]
