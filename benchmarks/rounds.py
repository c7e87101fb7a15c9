"""Synchronous rounds per second through the whole stack, against a bare Zenoh loop of the same payload.

N processes on the complete graph; in every round each publishes 30 float64 and waits for the others'. The stack is that
of a daemon: exchange, mailbox, codec, network, on the wall clock; there is no algorithm. The bare loop is written by
hand with Zenoh's defaults: a subscriber with a callback per neighbour, a queue, `put`. They run in turn, many times,
each turn in a random order. Only the ratios are meaningful: the median, with its 95 % confidence interval. Where the
interval contains 1, no difference was measured. On a machine with other load the ratio of processor times is the
steadier one.

    python benchmarks/rounds.py [--pairs 8] [--seconds 1.5] [--sizes 2 4 8] [--against TREE]

With ``--against`` the stack of another working tree of this project runs in turn, too:

    git worktree add ../before REVISION
    python benchmarks/rounds.py --against ../before
"""

import argparse
import io
import itertools
import json
import math
import os
import random
import socket
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import NamedTuple

import numpy as np

FLOORS = {2: 0.6, 4: 0.6, 8: 0.7}
VALUES = 30
PERIOD = 50  # rounds between looks at the time
TREE, SCRIPT = Path(__file__).parents[1], Path("benchmarks") / "rounds.py"
TIMEOUT = 60.0  # s for one run, start and end included


class Measured(NamedTuple):
    """Measurement of one process: rounds, real and processor time in s."""

    rounds: int
    real: float
    processor: float

    @classmethod
    def since(cls, rounds: int, real: float, processor: float) -> "Measured":
        return cls(rounds, time.monotonic() - real, time.process_time() - processor)


def report(measured: Measured) -> None:
    """Report to the parent, and keep the session open until all processes have finished."""
    print(json.dumps(measured), flush=True)
    sys.stdin.readline()


def bare(agent: int, ports: list[int], seconds: float) -> None:
    """Run rounds written by hand."""
    import zenoh  # noqa: PLC0415

    others = [j for j in range(len(ports)) if j != agent]
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "listen/endpoints": [f"tcp/127.0.0.1:{ports[agent]}"],
        "connect/endpoints": [f"tcp/127.0.0.1:{port}" for port in ports[:agent]],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    inbox: SimpleQueue[bytes] = SimpleQueue()
    values = np.random.default_rng(agent).normal(size=VALUES)
    received: defaultdict[int, dict[int, bytes]] = defaultdict(dict)  # round -> sender -> data

    def publish(number: int, stop: bool) -> None:
        publisher.put(bytes([agent, stop]) + number.to_bytes(4) + values.tobytes())

    def receive(number: int, timeout: float) -> None:
        """Wait for the messages of a round."""
        deadline = time.monotonic() + timeout
        while len(received[number]) < len(others):
            data = inbox.get(timeout=max(0.0, deadline - time.monotonic()))
            received[int.from_bytes(data[2:6])][data[0]] = data

    with zenoh.open(config) as session:
        for j in others:
            session.declare_subscriber(f"bench/from/{j}", lambda sample: inbox.put(sample.payload.to_bytes()))
        publisher = session.declare_publisher(f"bench/from/{agent}")
        end = time.monotonic() + TIMEOUT / 2
        while (
            len(received[0]) < len(others) and time.monotonic() < end
        ):  # until a message of each has been received in round 0
            publish(0, stop=False)
            with suppress(Empty):  # publish again
                receive(0, 0.02)
        publish(0, stop=False)
        number, stop, began, busy = 0, False, time.monotonic(), time.process_time()
        while not stop:
            number += 1
            mine = agent == 0 and number % PERIOD == 0 and time.monotonic() - began > seconds
            publish(number, stop=mine)
            receive(number, 10)
            stop = mine or any(data[1] for data in received.pop(number).values())
        report(Measured.since(number, began, busy))


def stack(agent: int, ports: list[int], seconds: float) -> None:  # noqa: PLR0915 - imports count
    """Run rounds with the parts of a daemon."""
    from agentd.daemon.runner import WallRunner, spare_collector  # noqa: PLC0415
    from dcf_zenoh.algorithms.algorithm import Dialogue  # noqa: PLC0415
    from dcf_zenoh.assembly import AgentParts  # noqa: PLC0415
    from dcf_zenoh.graph import Graph, Neighbourhood, metropolis  # noqa: PLC0415
    from dcf_zenoh.loop.agent import Ending  # noqa: PLC0415
    from dcf_zenoh.message import Last  # noqa: PLC0415
    from dcf_zenoh.messaging.address import Address, endpoints_to_connect  # noqa: PLC0415
    from dcf_zenoh.messaging.mailbox import Mailbox  # noqa: PLC0415
    from dcf_zenoh.messaging.network import Network  # noqa: PLC0415
    from dcf_zenoh.plant import NoPlant  # noqa: PLC0415
    from dcf_zenoh.records.log_writer import Recorder  # noqa: PLC0415
    from dcf_zenoh.requests import Loop, Wait  # noqa: PLC0415
    from dcf_zenoh.rounds.exchange import ComputeTime, Exchange, ExchangeOptions  # noqa: PLC0415
    from dcf_zenoh.rounds.receiver import Receiver  # noqa: PLC0415
    from dcf_zenoh.rounds.sender import Sender  # noqa: PLC0415
    from dcf_zenoh.rounds.synchronous import Synchronous  # noqa: PLC0415
    from dcf_zenoh.runner import drive  # noqa: PLC0415
    from dcf_zenoh.spec import Rounds  # noqa: PLC0415

    agents = range(len(ports))
    graph = Graph.of(agents, [(i, j) for i in agents for j in agents if i != j])
    neighbourhood = Neighbourhood.of(graph, agent, metropolis(graph))
    endpoints = {i: f"tcp/127.0.0.1:{port}" for i, port in enumerate(ports)}
    address = Address(
        "dcf/bench/1", endpoints[agent], endpoints_to_connect(agent, neighbourhood.receives_from, endpoints), {}
    )
    values = np.random.default_rng(agent).normal(size=VALUES)

    def dialogue() -> Dialogue[Measured]:
        yield {"values": values, "stop": False}, np.inf
        number, stop, began, busy = 0, False, time.monotonic(), time.process_time()
        while not stop:
            number += 1
            mine = agent == 0 and number % PERIOD == 0 and time.monotonic() - began > seconds
            if number % PERIOD == 0:
                receiver.passed.clear()  # as the record of a step does
            inbox = yield {"values": values, "stop": mine}, np.inf
            stop = mine or (agent != 0 and bool(inbox[0]["stop"]))
        return Measured.since(number, began, busy)

    found: list[Measured] = []

    def loop() -> Loop[Ending]:
        now = yield Wait(0)
        outcome = yield from exchange.negotiate(dialogue(), 0, now)
        found.append(outcome.result)
        return Ending(Last.DONE)

    mailbox = Mailbox(neighbourhood.receives_from)
    rounds = Rounds(max_rounds=10**9, threshold=0.0)
    receiver = Receiver(mailbox, hold=True, log_all=True)
    options = ExchangeOptions(time.perf_counter_ns, compute_time=ComputeTime(virtual=False))
    exchange = Exchange(agent, neighbourhood, rounds, mailbox, receiver, Sender(agent), Synchronous(rounds), options)
    parts = AgentParts(agent, NoPlant(), mailbox, {}, exchange, Recorder(io.BytesIO(), agent, {}), loop())
    with Network(agent, neighbourhood, address) as network:
        network.do_handshake("bench", TIMEOUT / 2)
        spare_collector()
        drive(parts.loop, WallRunner(parts, network, {}))
        report(found[0])


class Speed(NamedTuple):
    """Speed of one run: rounds per second, and processor time per round and process in µs."""

    rate: float
    processor: float


def measure(kind: str, tree: Path, count: int, seconds: float) -> Speed:
    """Run the bare loop or the stack in fresh processes, with the code of a working tree."""
    ports = free_ports(count)
    command = [sys.executable, str(tree / SCRIPT), "--seconds", str(seconds), "--ports", *map(str, ports)]
    children = [
        subprocess.Popen(
            [*command, "--worker", kind, str(i)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(tree)},
        )
        for i in range(count)
    ]
    try:
        found = [
            Measured(*json.loads(_line(child))) for child in children
        ]  # an empty line means that the process died: its error is printed above
        for child in children:
            child.communicate("done\n", timeout=TIMEOUT)
    finally:
        for child in children:
            child.kill()
            child.wait()
    return Speed(found[0].rounds / found[0].real, statistics.mean(m.processor / m.rounds for m in found) * 1e6)


def compare(name: str, ours: list[Speed], theirs: list[Speed]) -> str:
    """Return the medians of the ratios of runs in turn, with confidence intervals, and the medians themselves."""
    text = name
    for k, what in enumerate(("rounds/s", "processor time per round, µs")):
        ratios = [mine[k] / other[k] for mine, other in zip(ours, theirs, strict=True)]
        mine, other = (statistics.median(speed[k] for speed in side) for side in (ours, theirs))
        low, high = confidence(ratios)
        spread = f"{statistics.median(ratios):.3f} [{low:.3f} .. {high:.3f}]"
        text += f"{';' if k else ':'} {what} {spread} {mine:.0f} / {other:.0f}"
    return text


def confidence(values: list[float]) -> tuple[float, float]:
    """Return the 95 % confidence interval of the median, by the sign test; of fewer than six values their range."""
    count, ordered = len(values), sorted(values)
    tails = itertools.accumulate(math.comb(count, k) / 2**count for k in range(count // 2))
    outside = max(0, sum(2 * tail <= 0.05 for tail in tails) - 1)  # values beyond either end
    return ordered[outside], ordered[-1 - outside]


def _line(child: "subprocess.Popen[str]") -> str:
    assert child.stdout is not None
    return child.stdout.readline()


def free_ports(count: int) -> list[int]:
    """Return ports that are not in use now."""
    found: list[int] = []
    while len(found) < count:
        port = random.randrange(20000, 32000)
        with socket.socket() as probe:
            if port not in found and probe.connect_ex(("127.0.0.1", port)):
                found.append(port)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=1.5)
    parser.add_argument("--sizes", type=int, nargs="+", default=[2, 4, 8])
    parser.add_argument("--against", type=Path, metavar="TREE", help="another working tree, to compare with")
    parser.add_argument("--ports", type=int, nargs="+", help=argparse.SUPPRESS)
    parser.add_argument("--worker", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        kind, agent = options.worker
        {"bare": bare, "stack": stack}[kind](int(agent), options.ports, options.seconds)
        return
    sides = {"bare": ("bare", TREE), "stack": ("stack", TREE)}
    if options.against:
        sides["against"] = ("stack", options.against)
    print(f"{VALUES} float64, complete graph, {options.pairs} runs of each in turn, {options.seconds:g} s; medians")
    for count in options.sizes:
        print(f"  N = {count} (floor of rounds/s, stack / bare: {FLOORS.get(count, 0.6)})")
        runs: defaultdict[str, list[Speed]] = defaultdict(list)
        for _ in range(options.pairs):
            for side in random.sample(list(sides), len(sides)):
                runs[side].append(measure(*sides[side], count, options.seconds))
        print(compare("    stack / bare", runs["stack"], runs["bare"]))
        if options.against:
            print(compare(f"    stack / that of {options.against}", runs["stack"], runs["against"]))
            print(compare(f"    that of {options.against} / bare", runs["against"], runs["bare"]))


if __name__ == "__main__":
    main()
