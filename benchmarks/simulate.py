"""Speed of the simulator against real time, and against the bare algorithm generators in a plain loop.

Both fly the same position swap, round for round; they are timed in turn, in one process.

    python benchmarks/simulate.py [--pairs 8]
"""

import argparse
import statistics
import time
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

import dcf_zenoh
from dcf_zenoh.algorithms.algorithm import Inbox
from dcf_zenoh.algorithms.trades import trades
from dcf_zenoh.assembly import Blueprint
from dcf_zenoh.config import LoadedFleet, Overrides, load
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.position_swap import PositionSwap
from dcf_zenoh.testing import fleet_of

FLOOR = 8.0  # times real time
GOAL = 15.0


def plain_loop(fleet: LoadedFleet, rounds: list[int]) -> dict[int, Array]:
    """Fly the swap without any framework: the generators and the double integrator alone."""
    spec = fleet.spec
    problems = {
        i: PositionSwap(i, spec.ids, spec.time.sample_time, target=spec.agents[i].target or ()) for i in spec.ids
    }
    fleet_me = fleet_of(Blueprint.of(fleet).graph)
    states = {i: np.array([*(spec.agents[i].start or ()), 0.0, 0.0]) for i in spec.ids}
    algorithm = partial(trades)
    model = problems[spec.ids[0]]
    for count in rounds:
        running = {i: algorithm(problems[i].at(states), fleet_me[i]) for i in spec.ids}
        yielded = {i: next(dialogue) for i, dialogue in running.items()}
        for number in range(count):
            own = {i: payload for i, (payload, _) in yielded.items()}
            for i, dialogue in running.items():
                received = {j: own[j] for j in fleet_me[i].neighbours}
                try:
                    yielded[i] = dialogue.send(Inbox(own[i], received, stop=number + 1 == count))
                except StopIteration as finished:
                    fleet_me[i].remember(finished.value)
        for i in spec.ids:
            last = fleet_me[i].last
            assert last is not None
            states[i] = model.powers[1] @ states[i] + model.lifts[1] @ last
    return states


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=8)
    pairs = parser.parse_args().pairs
    fleet = load("position_swap", Overrides(clock="virtual"))
    run = dcf_zenoh.simulate(fleet)
    flown = run.steps * fleet.spec.time.sample_time
    shared = 1  # on a complete graph one round of each step shares the states
    rounds = [int(count) - shared for count in next(iter(run.agents.values())).rounds]
    with threadpool_limits(1):
        end = plain_loop(fleet, rounds)
        for i, log in run.agents.items():  # the comparison needs the same flight
            assert log.end is not None
            np.testing.assert_allclose(end[i], log.end["state"], atol=1e-9)
        simulated, plain = [], []
        for _ in range(pairs):
            began = time.perf_counter()
            dcf_zenoh.simulate(fleet)
            middle = time.perf_counter()
            plain_loop(fleet, rounds)
            simulated.append(middle - began)
            plain.append(time.perf_counter() - middle)
    speed = [flown / seconds for seconds in simulated]
    ratio = [a / b for a, b in zip(simulated, plain, strict=True)]
    print(f"{flown:.1f} s of flight, {sum(rounds)} rounds of {len(fleet.spec.ids)} agents, {pairs} alternating pairs")
    print(
        f"  times real time:      median {statistics.median(speed):5.1f}  best {max(speed):5.1f}"
        f" (floor {FLOOR:g}, goal {GOAL:g})"
    )
    print(f"  simulator/plain loop: median {statistics.median(ratio):5.2f}  best {min(ratio):5.2f}   (goal: at most 2)")


if __name__ == "__main__":
    main()
