"""Examination of a problem that is solved once, in one place before a run."""

from io import BytesIO

import numpy as np
from threadpoolctl import threadpool_limits

from dcf_zenoh.algorithms.needs import needs_of
from dcf_zenoh.analysis.oracle import share_of
from dcf_zenoh.assembly import Blueprint
from dcf_zenoh.config import LoadedFleet
from dcf_zenoh.configuration.building.problem_and_plant import problem_of
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.plugins import is_built_in, load
from dcf_zenoh.problems.central import solve_together
from dcf_zenoh.problems.share import Shareable

COARSE = 0.1  # threshold relative to the largest decision; agreement at a larger one says little


def note_on_problem(fleet: LoadedFleet) -> str | None:
    """Return what a run cannot find out: that there is no solution, or that the threshold is too large for it.

    None if neither is so, or if the problem is posed anew in every step or has no method `share`. Plug-ins that are
    not part of dcf-zenoh are not run.
    """
    spec = fleet.spec
    if spec.controller_kind.kind != "solve_once" or not is_built_in("problems", spec.problem.kind):
        return None
    problems = {i: problem_of(spec, fleet.folder, i) for i in spec.ids}
    if not all(isinstance(problem, Shareable) for problem in problems.values()):
        return None
    try:
        with threadpool_limits(1):
            answers = solve_together({i: share_of(problem) for i, problem in problems.items()})
    except AlgorithmError as error:
        return f"problem: {error}"
    largest, threshold = max(float(abs(u).max(initial=0.0)) for u in answers.values()), spec.exchange.threshold
    if threshold and np.isfinite(threshold) and threshold > COARSE * largest > 0:
        return (
            f"exchange.threshold: {threshold:g} is {threshold / largest:.0%} of the largest decision, {largest:.2g}: "
            f"the agents agree before their decisions are right; try {1e-3 * largest:.0e}"
        )
    return None


def try_out(fleet: LoadedFleet) -> None:
    """Build the parts of all agents as a run does, plug-ins included; nothing is started.

    Raises:
        DcfError: A constructor refuses its options, or the algorithm does not solve the problem.
    """
    blueprint, needed = Blueprint.of(fleet), needs_of(load("algorithms", fleet.spec.algorithm.kind, fleet.folder))
    for agent in fleet.spec.ids:
        blueprint.build(agent, BytesIO(), {})
        if needed is not None and fleet.spec.controller_kind.kind == "solve_once":
            problem = problem_of(fleet.spec, fleet.folder, agent)
            if reason := needed.of_problem(problem, type(problem).__name__):
                raise AlgorithmError(f"agent {agent}: {reason}")
