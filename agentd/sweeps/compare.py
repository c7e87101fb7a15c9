"""``agentd compare``: run variants of a fleet one after the other, and put the runs side by side."""

import json
import re
import sys
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path

from agentd.results.report import write_comparison
from agentd.results.scores import scores, scores_table, write_csv
from agentd.run_and_report import launch_with_progress, overrides_of, print_note, print_wide, simulate_into
from agentd.run_directory import new_folder, new_run_folder
from agentd.sweeps.variants import Variant, VariedFleet, load_all, variants
from dcf_zenoh.config import LoadedFleet
from dcf_zenoh.configuration.building.problem_and_plant import plant_classes
from dcf_zenoh.errors import ConfigurationError, DcfError, Interrupted
from dcf_zenoh.records.run import Run

LIMIT = 12  # of variants, so that they can be distinguished in a figure


@dataclass(frozen=True)
class VariantOutcome:
    """Run of one variant, or why there is none.

    Attributes:
        variant: Variant of the fleet.
        folder: Run directory.
        run: The run; None if it failed.
        failure: Why the run failed, in one line; empty if it did not.
    """

    variant: Variant
    folder: Path
    run: Run | None = None
    failure: str = ""


def compare_variants(options: Namespace) -> int:
    """Execute the command; return its exit code, 1 if a variant failed.

    Raises:
        ConfigurationError: A variant cannot be used. No run has begun.
        RecordingError: The directory cannot be written.
    """
    varied = VariedFleet(options.fleet, overrides_of(options), tuple(options.set))
    chosen = variants(options.vary, LIMIT)
    if len(chosen) < 2:
        raise ConfigurationError("--vary: one variant alone; give at least two values, such as plant=point,twin")
    fleets = load_all(chosen, lambda variant: _load(varied, variant, options))
    for note in dict.fromkeys(note for fleet in fleets for note in fleet.notes):
        print_note(note)
    name = fleets[0].spec.name
    folder = new_folder(f"compare-{name}", options.out)
    outcomes = []
    for number, (variant, fleet) in enumerate(zip(chosen, fleets, strict=True), start=1):
        if not options.json:
            print(f"agentd: {number} of {len(chosen)}: {variant.name}", file=sys.stderr)
        run_folder = folder / f"{number:02}-{re.sub(r'[^A-Za-z0-9_.]+', '-', variant.name).strip('-')[:60]}"
        outcomes.append(_run_variant(variant, fleet, new_run_folder(fleet.spec, run_folder), options))
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


def _load(varied: VariedFleet, variant: Variant, options: Namespace) -> LoadedFleet:
    """Load a variant with the clock of its run: virtual time, unless options or a real plant ask for another."""
    seed = options.seed
    fleet = varied.load(variant, clock=options.clock or (None if options.launch else "wall"), seed=seed)
    if options.clock or options.launch or _has_real_plant(fleet):
        return fleet
    return varied.load(variant, clock="virtual", seed=seed)


def _has_real_plant(fleet: LoadedFleet) -> bool:
    """Return whether a plant in use is real."""
    return any(plant.real for plant in plant_classes(fleet.spec, fleet.folder))


def _run_variant(variant: Variant, fleet: LoadedFleet, folder: Path, options: Namespace) -> VariantOutcome:
    """Run one variant."""
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
