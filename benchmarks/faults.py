"""Cost per message of a chain of three faults (loss, bursts, latency), against a link without faults.

Both get the same messages; their processor time is measured in turn, in one process.

    python benchmarks/faults.py [--pairs 15] [--messages 20000]
"""

import argparse
import statistics
import time
from pathlib import Path

import numpy as np

from dcf_zenoh.faults.bursts import Bursts
from dcf_zenoh.faults.chain import ALWAYS, FaultChain, Layer
from dcf_zenoh.faults.fault import FaultLink
from dcf_zenoh.faults.latency import Latency
from dcf_zenoh.faults.loss import Loss
from dcf_zenoh.message import Last, Message, canonical
from dcf_zenoh.messaging.delivery import Delivery

GOAL = 15.0  # µs


def chain() -> FaultChain:
    """Return a link that loses few messages, so that nearly all go through all three faults."""
    latency = Latency(FaultLink(1, 2, Path()), mean=0.03, distribution="normal", std=0.005)
    faults = {"loss": Loss(probability=0.01), "bursts": Bursts(mean_loss=0.01, mean_length=3.0), "latency": latency}
    return FaultChain(0, 1, 2, [Layer(name, [(ALWAYS, fault)]) for name, fault in faults.items()])


def stream(count: int) -> list[Delivery]:
    """Return messages of the size that a position swap sends, one per ms."""
    payload = canonical({"s": np.zeros(20), "c": np.zeros(10), "lam": np.zeros(10)})
    deliveries = []
    for number in range(count):
        at = number * 1_000_000
        message = Message(1, 0, number, 0, 0, at, -1, -1, 0, Last.NO, (0.1,), (), payload)
        deliveries.append(Delivery(message, at, at))
    return deliveries


def cost(link: FaultChain, deliveries: list[Delivery]) -> float:
    """Return the mean processor time per message, µs."""
    began = time.process_time()
    for each in deliveries:
        link.convey(each)
    return (time.process_time() - began) / len(deliveries) * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=15)
    parser.add_argument("--messages", type=int, default=20_000)
    options = parser.parse_args()
    deliveries = stream(options.messages)
    faulty, bare = [], []
    for _ in range(options.pairs):
        faulty.append(cost(chain(), deliveries))
        bare.append(cost(FaultChain(0, 1, 2), deliveries))
    ratio = [a / b for a, b in zip(faulty, bare, strict=True)]
    print(f"{options.messages} messages, {options.pairs} alternating pairs")
    print(f"  three faults, µs:  median {statistics.median(faulty):5.2f}  best {min(faulty):5.2f}   (goal: {GOAL:g})")
    print(f"  no faults, µs:     median {statistics.median(bare):5.2f}  best {min(bare):5.2f}")
    print(f"  three/no faults:   median {statistics.median(ratio):5.1f}  best {min(ratio):5.1f}")


if __name__ == "__main__":
    main()
