"""Random swaps that arrive, with detours and without: seeds of the fleet position_swap_random, in the simulator.

Each flight may take 60 s. Prints one line for each set, and exits with 1 if a flight with detours went below h = 0.

    python benchmarks/swaps.py [--agents 4 6 10] [--seeds 15 15 6] [--processes 2]
"""

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

from dcf_zenoh.simulation import simulate

SIDE = 2.0  # m, of the box of up to six agents
WIDE = 2.6  # m, for more agents


class Flight(NamedTuple):
    """Flight of one seed: arrival of all, s; least barrier value of any pair; detours begun; median rounds per step."""

    arrival: float | None
    barrier: float
    detours: float
    rounds: float


def fly(agents: int, seed: int, *, detour: bool) -> Flight:
    """Fly one seed."""
    half = (SIDE if agents <= 6 else WIDE) / 2
    changes = [
        f"layout.agents={agents}",
        f"layout.low=[{-half}, {-half}]",
        f"layout.high=[{half}, {half}]",
        f"controller.detour={str(detour).lower()}",
    ]
    summary = simulate("position_swap_random", seed=seed, changes=changes).summary()
    median = summary["rounds_per_step"]["median"]
    return Flight(summary["arrival_time"], summary["min_barrier"], summary["notes"].get("detours", 0), median)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", type=int, nargs="+", default=[4, 6, 10])
    parser.add_argument("--seeds", type=int, nargs="+", default=[15, 15, 6])
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--detour", choices=("on", "off", "both"), default="both")
    options = parser.parse_args()
    least = 0.0
    with ProcessPoolExecutor(options.processes, get_context("spawn")) as pool:
        for detour in {"on": (True,), "off": (False,), "both": (True, False)}[options.detour]:
            for agents, count in zip(options.agents, options.seeds, strict=True):
                began = time.perf_counter()
                jobs = [pool.submit(fly, agents, seed, detour=detour) for seed in range(1, count + 1)]
                flights = [job.result() for job in jobs]
                arrivals = [each.arrival for each in flights]
                lowest = min(each.barrier for each in flights)
                least = min(least, lowest) if detour else least
                print(
                    f"N = {agents:2}, detours {'on ' if detour else 'off'}:"
                    f" {sum(each is not None for each in arrivals):2} of {count} arrive; least h {lowest:.4f};"
                    f" arrivals {arrivals} s; detours {[int(each.detours) for each in flights]};"
                    f" {time.perf_counter() - began:.0f} s of computing",
                    flush=True,
                )
    sys.exit(least < 0)


if __name__ == "__main__":
    main()
