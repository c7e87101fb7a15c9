"""What several commands do: load a fleet as the options say, run it, and tell what came of it."""

import json
import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING

from agentd.run_directory import write_run_json
from dcf_zenoh.config import LoadedFleet, Overrides, load
from dcf_zenoh.errors import DcfError, Landed, RecordingError
from dcf_zenoh.records.run import Run

if TYPE_CHECKING:
    from rich.console import RenderableType

    from dcf_zenoh.analysis.oracle import Oracle

WIDE = 160  # characters


def launch_and_tell(fleet: LoadedFleet, folder: Path, options: Namespace) -> None:
    """Launch, and say what came of it, also when it failed."""
    failure: DcfError | None = None
    try:
        launch_with_progress(fleet, folder, quiet=options.json, yes=options.yes)
    except DcfError as error:
        failure = error
    try:
        tell(Run.read(folder), options)
    except RecordingError:
        if failure is None:
            raise
    if failure is not None:
        raise failure


def simulate_and_tell(fleet: LoadedFleet, folder: Path, options: Namespace) -> None:
    """Simulate, and say what came of it."""
    found = simulate_into(folder, fleet)
    tell(found, options)
    if landed := [log.landed for log in found.agents.values() if log.landed]:
        raise Landed("\n".join(landed))


def launch_with_progress(fleet: LoadedFleet, folder: Path, *, quiet: bool, yes: bool) -> None:
    """Launch a fleet and show its progress on standard error.

    Args:
        fleet: What to run.
        folder: An empty run directory.
        quiet: Print only what goes wrong.
        yes: Real bodies may take off without a key press.

    Raises:
        DcfError: As `agentd.launcher.launch.launch` does.
    """
    from agentd.launcher.launch import launch  # noqa: PLC0415 - imports Zenoh, which most commands do not need
    from agentd.launcher.progress import Progress  # noqa: PLC0415

    with Progress(fleet.spec, quiet=quiet) as progress:
        launch(fleet, folder, progress.show, progress.message, yes=yes)


def simulate_into(folder: Path, fleet: LoadedFleet) -> Run:
    """Simulate a fleet; return its run, which is in `folder`, an empty directory."""
    from dcf_zenoh.simulation import simulate  # noqa: PLC0415

    write_run_json(folder, {"fleet": fleet.spec.name, "run": folder.resolve().name, "source": fleet.source})
    return simulate(fleet, out=folder)


def load_as_asked(options: Namespace, *, run_plugins: bool = True, unused: bool = True) -> LoadedFleet:
    """The fleet that the options name; what the user should know goes to standard error."""
    fleet = load(
        options.fleet,
        Overrides(
            seed=options.seed,
            clock=options.clock,
            plant=options.plant,
            algorithm=options.algorithm,
            topology=options.topology,
        ),
        changes=options.set,
        run_plugins=run_plugins,
        unused=unused,
    )
    for note in fleet.notes:
        print(f"agentd: note: {note}", file=sys.stderr)
    return fleet


def read_run(folder: Path) -> Run:
    """A run; what is missing of it goes to standard error."""
    found = Run.read(folder)
    for gap in found.gaps:
        print(f"agentd: note: {gap}", file=sys.stderr)
    return found


def tell(run: Run, options: Namespace) -> None:
    """Summary and figures at the end of a run."""
    from rich.console import Console  # noqa: PLC0415

    from agentd.results.summary import summary_table  # noqa: PLC0415

    judged = judge([run]) if options.oracle else []
    summary = run.summary()
    if options.oracle:
        summary["oracle"] = judged[0].summary() if judged else None
    if options.json:
        print(json.dumps(summary), file=options.output)
    else:
        Console().print(summary_table(summary))
        print_judgement([run], judged)
    if not options.no_report and run.folder is not None:
        from agentd.results.report import write_oracle, write_report  # noqa: PLC0415

        written = write_report([run], run.folder, animate=options.animate)
        written += write_oracle([run], judged, run.folder) if judged else []
        if not options.json:
            figures = f", and {', '.join(path.name for path in written)}" if written else ""
            print(f"{run.folder}: log of every agent{figures}")


def judge(runs: Sequence[Run]) -> "list[Oracle]":
    """What a central solver says of each run; nothing, and a word to the user, if it cannot say it of all."""
    from dcf_zenoh.analysis.oracle import NoOracle, consult  # noqa: PLC0415 - OSQP is for those who need it

    try:
        return [consult(run) for run in runs]
    except NoOracle as error:
        print(f"agentd: note: --oracle: {error}", file=sys.stderr)
        return []


def print_judgement(runs: Sequence[Run], judged: "Sequence[Oracle]") -> None:
    """A table of what was found for each run."""
    from rich.console import Console  # noqa: PLC0415

    from agentd.results.oracle_table import oracle_table  # noqa: PLC0415

    for run, found in zip(runs, judged, strict=False):
        Console().print(oracle_table(run, found), highlight=False)


def print_wide(output: IO[str], *what: "RenderableType") -> None:
    """Print tables and lines in the width of the terminal, or in `WIDE` characters where there is none."""
    from rich.console import Console  # noqa: PLC0415 - daemons print no tables

    console = Console(file=output)
    console = console if console.is_terminal else Console(file=output, width=WIDE)
    console.print(*what, sep="\n", highlight=False)
