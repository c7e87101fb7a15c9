"""Speed of one simulated Crazyflie against real time: its body and its controller at 1 kHz, on one core.

    python benchmarks/crazyflie.py [--seconds 20]

It is measured in processor time, as other processes may share the core.
"""

import argparse
import time

import numpy as np

from dcf_zenoh.plant import Setpoint
from plants.crazyflie.simulated import Crazyflie
from plants.wind import WindOptions

GOAL = 100  # times real time
SAMPLE = 200_000_000  # ns


def speed(seconds: float, sensing: str, gusts: float) -> float:
    """Return simulated time divided by processor time, with a setpoint at every sample."""
    body = Crazyflie(
        np.zeros(2),
        0.2,
        np.random.Generator(np.random.Philox(1)),
        sensing=sensing,  # type: ignore[arg-type]
        wind=WindOptions(gusts=gusts),
    )
    body.prepare()
    body.start(0)
    began = time.process_time()
    for step in range(round(seconds / 0.2)):
        state = body.sense(step * SAMPLE)
        body.act(Setpoint(acceleration=-state.position[:2] - state.velocity[:2]), step * SAMPLE)
    return seconds / (time.process_time() - began)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated, for each row")
    seconds = parser.parse_args().seconds
    began = time.process_time()
    speed(0.2, "perfect", 0.0)
    print(f"loading the machine code and the first take-off: {time.process_time() - began:.2f} s of processor time")
    for sensing, gusts in (("perfect", 0.0), ("lighthouse", 0.0), ("lighthouse", 0.5)):
        times = speed(seconds, sensing, gusts)
        verdict = "as it should" if times >= GOAL else f"MISSES the goal of {GOAL}"
        print(f"sensing {sensing:10}  gusts {gusts:.1f} m/s  {times:5.0f} times real time, {verdict}")


if __name__ == "__main__":
    main()
