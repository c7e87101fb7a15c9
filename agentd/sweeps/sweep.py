"""Many runs of one fleet in the simulator: every variant with every seed, on all cores, and one table of them."""

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
from agentd.run_and_report import print_wide, simulate_into
from agentd.sweeps.sweep_folder import Row, SweepFolder, Task, plan_of
from agentd.sweeps.sweep_progress import SweepProgress
from agentd.sweeps.sweep_table import sweep_table
from agentd.sweeps.variants import Variant, load_all, variants
from agentd.sweeps.workers import WorkerDied, spread
from dcf_zenoh import config
from dcf_zenoh.analysis.oracle import NoOracle, consult
from dcf_zenoh.config import LoadedFleet, Overrides
from dcf_zenoh.configuration.building.problem_and_plant import plant_classes
from dcf_zenoh.errors import ConfigurationError, DcfError, Interrupted
from dcf_zenoh.records.run import Run
from dcf_zenoh.simulation import simulate

MOST = 1000  # variants; and so many seeds
ORACLE = ("gap_median", "gap_max", "plan_gap_median", "plan_gap_max", "violation", "oracle_unsolved")
NOT_SWEPT = {
    "seed": "--seeds says how many there are",
    "clock": "a sweep is simulated, in virtual time",
}


class Choices(NamedTuple):
    """What all runs of a sweep have in common; goes to other processes.

    Attributes:
        fleet: As the command line names it.
        set: As `--set` has it.
        plant: As `--plant` has it.
        algorithm: As `--algorithm` has it.
        topology: As `--topology` has it.
    """

    fleet: str
    set: tuple[str, ...]
    plant: str | None
    algorithm: str | None
    topology: str | None

    def load(self, variant: Variant, seed: int | None) -> LoadedFleet:
        """The fleet of a variant.

        Raises:
            ConfigurationError: It cannot be used.
        """
        return config.load(
            self.fleet,
            Overrides(
                seed=seed,
                clock="virtual",
                plant=variant.choice("plant") or self.plant,
                algorithm=variant.choice("algorithm") or self.algorithm,
                topology=self.topology,
            ),
            changes=[*self.set, *variant.changes],
        )


class Job(NamedTuple):
    """One run, as a process is told of it.

    Attributes:
        choices: Common to all.
        task: Variant and seed.
        keep: Where its run directory goes; None: nowhere.
        oracle: Also solve every step in one place, where the problem allows it.
    """

    choices: Choices
    task: Task
    keep: Path | None
    oracle: bool


def sweep_variants(options: Namespace) -> int:
    """Run all variants that the command line asks for with all seeds, and say what came of them; the exit code.

    Raises:
        ConfigurationError: A variant is not usable. Nothing has run.
        RecordingError: The directory cannot be used.
    """
    choices = Choices(options.fleet, tuple(options.set), options.plant, options.algorithm, options.topology)
    chosen = _variants(options)
    fleets = load_all(chosen, lambda variant: choices.load(variant, options.seed))
    _refuse_real(chosen, fleets)
    for note in dict.fromkeys(note for fleet in fleets for note in fleet.notes):
        print(f"agentd: note: {note}", file=sys.stderr)
    first = fleets[0].spec.seed
    seeds = range(first, first + options.seeds)
    plan = plan_of(chosen, fleets, seeds=list(seeds), oracle=not options.no_oracle)
    folder = SweepFolder.open(options.out, plan)
    tasks = [Task(number, variant, seed) for number, variant in enumerate(chosen, start=1) for seed in seeds]
    rows = _rows(folder, tasks, choices, options)
    write_csv(folder.path / "sweep.csv", rows)
    written = write_sweep(rows, _axes(chosen), folder.path)
    if options.json:
        found = {"fleet": plan["name"], "folder": str(folder.path), "runs": rows}
        print(json.dumps(found), file=options.output)
    else:
        title = f"{plan['name']}: {len(chosen)} variants, {len(seeds)} seeds"
        print_wide(options.output, sweep_table(title, rows))
        files = ", ".join(path.name for path in [folder.path / "sweep.csv", *written])
        print(f"{folder.path}: {files}", file=options.output)
    return 1 if any(row["failed"] for row in rows) else 0


def run_one(job: Job) -> Row:
    """One row of the table, in whatever process: what varies, the seed, why the run failed (or None), and numbers."""
    row = _head(job.task)
    try:
        fleet = job.choices.load(job.task.variant, job.task.seed)
        run = simulate(fleet) if job.keep is None else simulate_into(_emptied(job.keep), fleet)
        measured = {**scores(run), **_judged(run, wanted=job.oracle)}
        failure = None
    except Exception as error:  # of whatever kind: the other runs go on
        text = str(error) if isinstance(error, DcfError) else f"{type(error).__name__}: {error}"
        measured, failure = {**scores(None), **dict.fromkeys(ORACLE)}, " ".join(text.split())
    return {**row, "failed": failure, **measured}


def _variants(options: Namespace) -> list[Variant]:
    """What the command line asks for.

    Raises:
        ConfigurationError: It is not usable.
    """
    if options.seeds < 1 or options.seeds > MOST:
        raise ConfigurationError(f"--seeds {options.seeds}: expected a whole number between 1 and {MOST}")
    if options.clock == "wall":
        raise ConfigurationError("--clock wall: a sweep is simulated, in virtual time")
    if options.processes is not None and options.processes < 1:
        raise ConfigurationError(f"--processes {options.processes}: expected a whole number, at least 1")
    chosen = variants(options.vary, MOST)
    for key, instead in NOT_SWEPT.items():
        if key in chosen[0].values:
            raise ConfigurationError(f"--vary {key}: {instead}")
    return chosen


def _refuse_real(variants: Sequence[Variant], fleets: Sequence[LoadedFleet]) -> None:
    for variant, fleet in zip(variants, fleets, strict=True):
        if any(plant.real for plant in plant_classes(fleet.spec, fleet.folder)):
            raise ConfigurationError(f"{variant.name}: its plant is real; a sweep is simulated")


def _rows(folder: SweepFolder, tasks: Sequence[Task], choices: Choices, options: Namespace) -> list[Row]:
    """All rows, in the order of `tasks`: those that are there, and those of what is run now."""
    rows = {task.name: row for task in tasks if (row := folder.row(task)) is not None}
    left = [task for task in tasks if task.name not in rows]
    jobs = [Job(choices, task, folder.run(task) if options.keep else None, not options.no_oracle) for task in left]
    try:
        with (
            _asked_to_stop(),
            SweepProgress(len(tasks), len(rows), quiet=options.json) as progress,
            closing(spread(run_one, jobs, options.processes or _cores())) as results,
        ):
            for number, result in results:
                task = left[number]
                if isinstance(result, WorkerDied):  # nothing is written down: it is tried again if the sweep is
                    row = {**_head(task), "failed": str(result), **scores(None), **dict.fromkeys(ORACLE)}
                else:
                    row = result
                    folder.keep(task, row)
                rows[task.name] = row
                if row["failed"]:
                    progress.say(f"{task.variant.name}, seed={task.seed}: failed: {row['failed']}")
                progress.done()
    except (KeyboardInterrupt, Interrupted):
        print(
            f"agentd: {len(rows)} of {len(tasks)} runs are in {folder.path}; the same command with"
            f" --out {folder.path} goes on from there",
            file=sys.stderr,
        )
        raise
    return [rows[task.name] for task in tasks]


def _head(task: Task) -> Row:
    """With what a row begins."""
    return {"variant": task.variant.name, **task.variant.values, "seed": task.seed}


def _axes(variants: Sequence[Variant]) -> dict[str, list[str]]:
    """What is varied -> its values, in order."""
    return {key: list(dict.fromkeys(variant.values[key] for variant in variants)) for key in variants[0].values}


def _emptied(folder: Path) -> Path:
    """Make a directory, or remove what an interrupted run has left in it; return it."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def _judged(run: Run, *, wanted: bool) -> Mapping[str, Any]:
    """`ORACLE`: how near the decisions came to those of a central solver; None where it cannot tell."""
    if not wanted:
        return dict.fromkeys(ORACLE)
    try:
        found = consult(run).summary()
    except NoOracle:
        return dict.fromkeys(ORACLE)
    gap, plan_gap = found["gap"], found["plan_gap"]
    values = (
        gap["median"], gap["max"], plan_gap["median"], plan_gap["max"], found["violation"], found["unsolved"],
    )  # fmt: skip
    return dict(zip(ORACLE, values, strict=True))


def _cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def _asked_to_stop() -> Iterator[None]:
    """SIGTERM and SIGHUP are errors, so that what runs is ended as after Ctrl-C."""

    def stop(number: int, _frame: FrameType | None) -> None:
        raise Interrupted(f"stopped by {signal.Signals(number).name}", number)

    numbers = [signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
