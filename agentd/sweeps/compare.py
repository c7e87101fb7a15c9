"""Variants of one fleet, run one after the other and put side by side."""

import json
import re
import sys
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

from agentd.results.report import write_comparison
from agentd.results.scores import scores, scores_table, write_csv
from agentd.run_and_report import launch_with_progress, print_wide, simulate_into
from agentd.run_directory import new_folder, new_run_folder
from agentd.sweeps.variants import Variant, load_all, variants
from dcf_zenoh import config
from dcf_zenoh.config import LoadedFleet, Overrides
from dcf_zenoh.configuration.building.problem_and_plant import plant_classes
from dcf_zenoh.errors import ConfigurationError, DcfError, Interrupted
from dcf_zenoh.records.run import Run

MOST = 12  # variants that can still be told apart side by side


@dataclass(frozen=True)
class VariantOutcome:
    """What came of one variant.

    Attributes:
        variant: The variant.
        folder: Its run directory.
        run: The run; None if it failed.
        failure: Why it failed, in one line.
    """

    variant: Variant
    folder: Path
    run: Run | None = None
    failure: str = ""


def compare_variants(options: Namespace) -> int:
    """Run all variants that the command line asks for, and say what came of them; the exit code.

    Raises:
        ConfigurationError: A variant is not usable. Nothing has run.
        RecordingError: The directory cannot be written.
    """
    chosen = variants(options.vary, MOST)
    if len(chosen) < 2:
        raise ConfigurationError("--vary: one variant alone; give at least two values, such as plant=point,twin")
    fleets = load_all(chosen, lambda variant: _load(variant, options))
    for note in dict.fromkeys(note for fleet in fleets for note in fleet.notes):
        print(f"agentd: note: {note}", file=sys.stderr)
    name = fleets[0].spec.name
    folder = new_folder(f"compare-{name}", options.out)
    outcomes = []
    for number, (variant, fleet) in enumerate(zip(chosen, fleets, strict=True), start=1):
        if not options.json:
            print(f"agentd: {number} of {len(chosen)}: {variant.name}", file=sys.stderr)
        place = folder / f"{number:02}-{re.sub(r'[^A-Za-z0-9_.]+', '-', variant.name).strip('-')[:60]}"
        outcomes.append(_outcome(variant, fleet, new_run_folder(fleet.spec, place), options))
    rows = [
        {"variant": each.variant.name, "run": str(each.folder), "failed": each.failure or None, **scores(each.run)}
        for each in outcomes
    ]
    write_csv(folder / "comparison.csv", rows)
    written = write_comparison({each.variant.name: each.run or each.failure for each in outcomes}, folder)
    if options.json:
        print(json.dumps({"fleet": name, "folder": str(folder), "variants": rows}), file=options.output)
    else:
        print_wide(options.output, scores_table(f"{name}: {len(rows)} variants", rows))
        files = ", ".join(path.name for path in [folder / "comparison.csv", *written])
        print(f"{folder}: the runs, and {files}", file=options.output)
    return 1 if any(outcome.failure for outcome in outcomes) else 0


def _load(variant: Variant, options: Namespace) -> LoadedFleet:
    """The fleet of a variant, on the clock that it will have."""

    def load(clock: str | None) -> LoadedFleet:
        return config.load(
            options.fleet,
            Overrides(
                seed=options.seed,
                clock=clock,
                plant=variant.choice("plant") or options.plant,
                algorithm=variant.choice("algorithm") or options.algorithm,
                topology=options.topology,
            ),
            changes=[*options.set, *variant.changes],
        )

    fleet = load(options.clock or (None if options.launch else "wall"))
    if options.clock or options.launch or _moves_really(fleet):
        return fleet
    return load("virtual")


def _moves_really(fleet: LoadedFleet) -> bool:
    """Whether any plant in use moves in the real world."""
    return any(plant.real for plant in plant_classes(fleet.spec, fleet.folder))


def _outcome(variant: Variant, fleet: LoadedFleet, folder: Path, options: Namespace) -> VariantOutcome:
    """Run one variant, and read what it left."""
    try:
        if options.launch or fleet.spec.time.clock == "wall":
            launch_with_progress(fleet, folder, quiet=options.json, yes=options.yes)
            return VariantOutcome(variant, folder, Run.read(folder))
        return VariantOutcome(variant, folder, simulate_into(folder, fleet))
    except Interrupted:
        raise
    except DcfError as error:
        failure = " ".join(str(error).split())
        print(f"agentd: {variant.name}: failed: {failure}", file=sys.stderr)
        return VariantOutcome(variant, folder, failure=failure)
