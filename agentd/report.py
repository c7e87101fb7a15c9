"""The report of one run, or of several side by side: figures as PNG and PDF, the flight as GIF."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from dcf_zenoh.errors import RecordingError
from dcf_zenoh.run import Run


def write_report(runs: Sequence[Run], folder: Path, *, animate: bool = False) -> list[Path]:
    """Draw all figures for which the runs have something to show; older ones in `folder` are replaced.

    Args:
        runs: Shown side by side, in this order.
        folder: Made if it is not there.
        animate: Also write a GIF of every flight.

    Returns:
        The files written.

    Raises:
        RecordingError: `folder` cannot be written.
    """
    # Here and nowhere else, so that daemons never import matplotlib.
    from matplotlib import rc_context  # noqa: PLC0415

    from agentd.figures import FIGURES  # noqa: PLC0415
    from agentd.figures.flight import write_flight  # noqa: PLC0415
    from agentd.figures.style import STYLE  # noqa: PLC0415

    written: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with rc_context(STYLE):
            for name, draw in FIGURES.items():
                figure = draw(runs)
                if figure is None:
                    continue
                for ending in ("png", "pdf"):
                    written.append(folder / f"{name}.{ending}")
                    figure.savefig(written[-1], bbox_inches="tight")
            for run, path in zip(runs, _flights(runs, folder), strict=True):
                if animate and write_flight(run, path):
                    written.append(path)
    except OSError as error:
        raise RecordingError(f"{error.filename or folder}: cannot be written: {error.strerror}") from error
    return written


def _flights(runs: Sequence[Run], folder: Path) -> list[Path]:
    """One GIF per run: 'flight.gif', or with the run's name, numbered where two runs have the same."""
    if len(runs) == 1:
        return [folder / "flight.gif"]
    often = Counter(run.name for run in runs)
    return [
        folder / (f"flight-{run.name}.gif" if often[run.name] == 1 else f"flight-{run.name}-{number}.gif")
        for number, run in enumerate(runs, start=1)
    ]
