"""``agentd sweep``: simulate every variant of a fleet with many seeds, in parallel, and make one table of the runs."""

import json
import os
import shutil
import signal
import sys
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

from agentd.results.report import write_sweep
from agentd.results.scores import scores, write_csv
from agentd.run_and_report import overrides_of, print_note, print_wide, simulate_into
from agentd.sweeps.sweep_folder import Row, SweepFolder, Task, plan_of
from agentd.sweeps.sweep_progress import SweepProgress
from agentd.sweeps.sweep_table import sweep_table
from agentd.sweeps.variants import Variant, VariedFleet, load_all, variants
from agentd.sweeps.workers import WorkerDied, run_in_processes
from dcf_zenoh.analysis.oracle import NoOracle, consult
from dcf_zenoh.config import LoadedFleet
from dcf_zenoh.configuration.building.problem_and_plant import plant_classes
from dcf_zenoh.errors import ConfigurationError, DcfError, Interrupted
from dcf_zenoh.records.run import Run
from dcf_zenoh.simulation import simulate

LIMIT = 1000  # of variants, and of seeds
ORACLE = ("gap_median", "gap_max", "plan_gap_median", "plan_gap_max", "violation", "oracle_unsolved")
NOT_SWEPT = {
    "seed": "--seeds says how many there are",
    "clock": "a sweep is simulated, in virtual time",
}


class Job(NamedTuple):
    """One run of a sweep with everything that a worker process needs.

    Attributes:
        fleet: Fleet that is varied.
        task: Variant and seed.
        folder: Run directory; None if the run is not kept.
        oracle: Whether to compare decisions with those of a central solver, where the problem has one.
    """

    fleet: VariedFleet
    task: Task
    folder: Path | None
    oracle: bool


def sweep_variants(options: Namespace) -> int:
    """Execute the command; return its exit code, 1 if a run failed.

    Raises:
        ConfigurationError: A variant cannot be used. No run has begun.
        RecordingError: The directory cannot be used.
    """
    varied = VariedFleet(options.fleet, overrides_of(options), tuple(options.set))
    chosen = _requested_variants(options)
    fleets = load_all(chosen, lambda variant: varied.load(variant, clock="virtual", seed=options.seed))
    _check_simulated(chosen, fleets)
    for note in dict.fromkeys(note for fleet in fleets for note in fleet.notes):
        print_note(note)
    first = fleets[0].spec.seed
    seeds = range(first, first + options.seeds)
    plan = plan_of(chosen, fleets, seeds=seeds, oracle=not options.no_oracle)
    folder = SweepFolder.open(options.out, plan)
    tasks = [Task(number, variant, seed) for number, variant in enumerate(chosen, start=1) for seed in seeds]
    rows = _all_rows(folder, tasks, varied, options)
    write_csv(folder.path / "sweep.csv", rows)
    written = write_sweep(rows, _axes(chosen), folder.path)
    if options.json:
        content = {"fleet": plan["name"], "folder": str(folder.path), "runs": rows}
        print(json.dumps(content), file=options.output)
    else:
        title = f"{plan['name']}: {len(chosen)} variants, {len(seeds)} seeds"
        print_wide(options.output, sweep_table(title, rows))
        files = ", ".join(path.name for path in [folder.path / "sweep.csv", *written])
        print(f"{folder.path}: {files}", file=options.output)
    return 1 if any(row["failed"] for row in rows) else 0


def run_one(job: Job) -> Row:
    """Simulate one run in this process; return its row: variant, seed, why it failed (or None), and measures."""
    row = _row_begin(job.task)
    try:
        fleet = job.fleet.load(job.task.variant, clock="virtual", seed=job.task.seed)
        run = simulate(fleet) if job.folder is None else simulate_into(_emptied(job.folder), fleet)
        measured = {**scores(run), **_oracle_measures(run, wanted=job.oracle)}
        failure = None
    except Exception as error:  # any failure is recorded, and the sweep continues
        text = str(error) if isinstance(error, DcfError) else f"{type(error).__name__}: {error}"
        measured, failure = {**scores(None), **dict.fromkeys(ORACLE)}, " ".join(text.split())
    return {**row, "failed": failure, **measured}


def _requested_variants(options: Namespace) -> list[Variant]:
    """Return the variants that the command line requests.

    Raises:
        ConfigurationError: An option cannot be used.
    """
    if options.seeds < 1 or options.seeds > LIMIT:
        raise ConfigurationError(f"--seeds {options.seeds}: expected a whole number between 1 and {LIMIT}")
    if options.clock == "wall":
        raise ConfigurationError("--clock wall: a sweep is simulated, in virtual time")
    if options.processes is not None and options.processes < 1:
        raise ConfigurationError(f"--processes {options.processes}: expected a whole number, at least 1")
    chosen = variants(options.vary, LIMIT)
    for key, instead in NOT_SWEPT.items():
        if key in chosen[0].values:
            raise ConfigurationError(f"--vary {key}: {instead}")
    return chosen


def _check_simulated(variants: Sequence[Variant], fleets: Sequence[LoadedFleet]) -> None:
    """Raise an error if a plant in use is real.

    Raises:
        ConfigurationError: It is.
    """
    for variant, fleet in zip(variants, fleets, strict=True):
        if any(plant.real for plant in plant_classes(fleet.spec, fleet.folder)):
            raise ConfigurationError(f"{variant.name}: its plant is real; a sweep is simulated")


def _all_rows(folder: SweepFolder, tasks: Sequence[Task], varied: VariedFleet, options: Namespace) -> list[Row]:
    """Return the rows of all tasks, in their order: those recorded before, and those of the runs made now."""
    rows = {task.name: row for task in tasks if (row := folder.read_row(task)) is not None}
    missing = [task for task in tasks if task.name not in rows]
    jobs = [
        Job(varied, task, folder.run_folder(task) if options.keep else None, not options.no_oracle) for task in missing
    ]
    try:
        with (
            _signals_as_errors(),
            SweepProgress(len(tasks), len(rows), quiet=options.json) as progress,
            closing(run_in_processes(run_one, jobs, options.processes or _available_cores())) as results,
        ):
            for index, result in results:
                task = missing[index]
                if isinstance(result, WorkerDied):  # not recorded, so that a continued sweep tries it again
                    row = {**_row_begin(task), "failed": str(result), **scores(None), **dict.fromkeys(ORACLE)}
                else:
                    row = result
                    folder.write_row(task, row)
                rows[task.name] = row
                if row["failed"]:
                    progress.message(f"{task.variant.name}, seed={task.seed}: failed: {row['failed']}")
                progress.run_finished()
    except (KeyboardInterrupt, Interrupted):
        print(
            f"agentd: {len(rows)} of {len(tasks)} runs are in {folder.path}; the same command with"
            f" --out {folder.path} goes on from there",
            file=sys.stderr,
        )
        raise
    return [rows[task.name] for task in tasks]


def _row_begin(task: Task) -> Row:
    """Return the first columns of a row, which identify the run."""
    return {"variant": task.variant.name, **task.variant.values, "seed": task.seed}


def _axes(variants: Sequence[Variant]) -> dict[str, list[str]]:
    """Return varied key -> its values, in order."""
    return {key: list(dict.fromkeys(variant.values[key] for variant in variants)) for key in variants[0].values}


def _emptied(folder: Path) -> Path:
    """Make a directory, or remove what an interrupted run has left in it; return it."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def _oracle_measures(run: Run, *, wanted: bool) -> Mapping[str, Any]:
    """Return the measures `ORACLE`, distances to central solutions; None for each that is not known or not wanted."""
    if not wanted:
        return dict.fromkeys(ORACLE)
    try:
        summary = consult(run).summary()
    except NoOracle:
        return dict.fromkeys(ORACLE)
    gap, plan_gap = summary["gap"], summary["plan_gap"]
    values = (
        gap["median"], gap["max"], plan_gap["median"], plan_gap["max"], summary["violation"], summary["unsolved"],
    )  # fmt: skip
    return dict(zip(ORACLE, values, strict=True))


def _available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _signals_as_errors() -> Iterator[None]:
    """Raise `Interrupted` on SIGTERM and SIGHUP within the context, so that they end all processes as Ctrl-C does."""

    def on_signal(number: int, _frame: FrameType | None) -> None:
        raise Interrupted(f"stopped by {signal.Signals(number).name}", number)

    numbers = [signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
