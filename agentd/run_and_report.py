"""Steps that commands share: load a fleet with the options applied, run it, and report the run."""

import json
import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING

from agentd.run_directory import followed, write_run_json
from dcf_zenoh.config import LoadedFleet, Overrides, load
from dcf_zenoh.errors import DcfError, HasFindings, Landed, RecordingError
from dcf_zenoh.records.run import Run

if TYPE_CHECKING:  # these take time to import, and daemons need neither
    from rich.console import RenderableType

    from dcf_zenoh.analysis.oracle import Oracle

WIDTH = 160  # characters of a line where there is no terminal


def launch_and_report(fleet: LoadedFleet, folder: Path, options: Namespace) -> None:
    """Launch a fleet and report its run, even if the launch fails.

    Args:
        fleet: Fleet to run.
        folder: An empty run directory.
        options: Options of the command line.

    Raises:
        DcfError: The launch failed; or it did not, and the run cannot be read.
    """
    failure: DcfError | None = None
    with followed(folder) as place:
        try:
            launch_with_progress(fleet, folder, quiet=options.json, yes=options.yes)
        except DcfError as error:
            failure = error
        found = place()
    try:
        report_run(Run.read(found), options)
    except DcfError:  # of the launch is known more: the reason comes first
        if failure is None:
            raise
    if failure is not None:
        raise failure


def simulate_and_report(fleet: LoadedFleet, folder: Path, options: Namespace) -> None:
    """Simulate a fleet and report its run.

    Args:
        fleet: Fleet to run.
        folder: An empty run directory.
        options: Options of the command line.

    Raises:
        Landed: Agents landed before the planned end.
        HasFindings: The run has findings, and the options allow none.
    """
    run = simulate_into(folder, fleet)
    landed = [log.landed for log in run.agents.values() if log.landed]
    try:
        report_run(run, options)
    except HasFindings:  # of a landing is known more: the reason comes first
        if not landed:
            raise
    if landed:
        raise Landed("\n".join(landed))


def launch_with_progress(fleet: LoadedFleet, folder: Path, *, quiet: bool, yes: bool) -> None:
    """Launch a fleet and show its progress on standard error.

    Args:
        fleet: Fleet to run.
        folder: An empty run directory.
        quiet: Print failures only.
        yes: Whether real bodies may take off without a key press.

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


def load_fleet(options: Namespace, *, run_plugins: bool = True, unused: bool = True) -> LoadedFleet:
    """Load the fleet that the options name; print notes on it on standard error.

    Args:
        options: Options of the command line.
        run_plugins: As in `dcf_zenoh.config.load`.
        unused: As in `dcf_zenoh.config.load`.

    Raises:
        ConfigurationError: The fleet cannot be used.
    """
    fleet = load(options.fleet, overrides_of(options), changes=options.set, run_plugins=run_plugins, unused=unused)
    for note in fleet.notes:
        print_note(note)
    return fleet


def overrides_of(options: Namespace) -> Overrides:
    """Return the choices that replace those of the fleet file."""
    return Overrides(
        seed=options.seed,
        clock=options.clock,
        plant=options.plant,
        algorithm=options.algorithm,
        topology=options.topology,
    )


def read_run(folder: Path) -> Run:
    """Read a run; print a note on standard error about each gap in it.

    Raises:
        RecordingError: There is no run in the directory, or it cannot be read.
    """
    run = Run.read(folder)
    for gap in run.gaps:
        print_note(gap)
    return run


def report_run(run: Run, options: Namespace) -> None:
    """Print the summary of a run, and draw its figures unless the options forbid it.

    Raises:
        HasFindings: It has findings, and the options allow none.
        RecordingError: The figures cannot be written.
    """
    from rich.console import Console  # noqa: PLC0415

    from agentd.results.summary import summary_table  # noqa: PLC0415

    oracles = consult_oracle([run]) if options.oracle else []
    summary = run.summary()
    if options.oracle:
        summary["oracle"] = oracles[0].summary() if oracles else None
    if options.json:
        print(json.dumps(summary), file=options.output)
    else:
        Console().print(summary_table(summary))
        print_oracles([run], oracles)
    if not options.no_report and run.folder is not None:
        from agentd.results.report import write_oracle, write_report  # noqa: PLC0415

        try:
            written = write_report([run], run.folder, animate=options.animate)
            written += write_oracle([run], oracles, run.folder) if oracles else []
        except OSError as error:
            raise RecordingError(f"{run.folder}: the figures cannot be written: {error.strerror}") from error
        if not options.json:
            figures = f", and {', '.join(path.name for path in written)}" if written else ""
            print(f"{run.folder}: log of every agent{figures}")
    check_findings([run], options)


def check_findings(runs: Sequence[Run], options: Namespace) -> None:
    """Raise HasFindings if a run has findings and the options allow none."""
    found = [each for run in runs for each in run.findings]
    if options.strict and found:
        more = f"; and {len(found) - 1} more" if len(found) > 1 else ""
        raise HasFindings(f"--strict: {found[0].text}{more}")


def consult_oracle(runs: Sequence[Run]) -> "list[Oracle]":
    """Compare each run with its central solution; print a note and return an empty list if that fails for one."""
    from dcf_zenoh.analysis.oracle import NoOracle, consult  # noqa: PLC0415 - imports scipy

    try:
        return [consult(run) for run in runs]
    except NoOracle as error:
        print_note(f"--oracle: {error}")
        return []


def print_oracles(runs: Sequence[Run], oracles: "Sequence[Oracle]") -> None:
    """Print a table of the comparison of each run with its central solution."""
    from rich.console import Console  # noqa: PLC0415

    from agentd.results.oracle_table import oracle_table  # noqa: PLC0415

    for run, oracle in zip(runs, oracles, strict=False):
        Console().print(oracle_table(run, oracle), highlight=False)


def print_wide(output: IO[str], *what: "RenderableType") -> None:
    """Print tables and lines in the width of the terminal, or in `WIDTH` characters where there is none."""
    from rich.console import Console  # noqa: PLC0415

    console = Console(file=output)
    console = console if console.is_terminal else Console(file=output, width=WIDTH)
    console.print(*what, sep="\n", highlight=False)


def print_note(text: str) -> None:
    """Print a note on standard error."""
    print(f"agentd: note: {text}", file=sys.stderr)
