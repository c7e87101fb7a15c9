"""A program that puts messages near and beyond all bounds through the codec, the mailbox, the receiver and live agents.

    python -m tests.support.storms FOLDER COUNT SEED

prints one JSON object per stage: what it took, and what was refused. COUNT is for each of the first two stages; the
live fleet gets as many as it can take while it flies.
"""

import json
import math
import random
import resource
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import zenoh

from dcf_zenoh.errors import MessageError
from dcf_zenoh.message import BOUNDS, BYTES_MAX, DTYPES, NEVER, VERSION, Last, Message, decode, encode
from dcf_zenoh.messaging.mailbox import AHEAD_MAX, GAP_MAX, RESTARTS_MAX, Limits, Mailbox
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import log_name
from dcf_zenoh.rounds.receiver import Receiver
from tests.support.daemons import Launch
from tests.support.small_fleet import small_fleet
from tests.support.strangers import bare_session
from tests.support.waiting import until

STEPS, ROUNDS = 1000, 8  # of the flight in one process
SIZES: list[Any] = [0, 1, 2, 3, 8, 2**16, 2**22, 2**31, 2**32, 2**62, 2**63 - 1, 2**63, 2**64 - 1, -1, 1.5, None, "3"]
ODD = [None, True, -1, 1.5, "7", b"7", [], {}, [1], {"x": 1}, math.nan, math.inf, -math.inf, 2**64 - 1, -(2**63)]

FLEET = small_fleet(
    "storm",
    time={"clock": "wall", "sample_time": 0.1, "duration": 8.0, "arrived": {"within": 0.1, "for": 0.3}},
    exchange={"budget": 0.07, "max_rounds": 40, "round_timeout": 0.01},
    safety={"neighbour_silent": {"after": 1.0, "then": "continue"}},
    controller={"kind": "receding_horizon", "sharing": "piggyback", "lost_after": 1.0},
    algorithm={"kind": "trades_robust"},
)


def near(chance: random.Random, *bounds: float) -> int:
    """Return an integer at a bound, next to one, or anywhere that msgpack can encode."""
    if chance.random() < 0.1:
        return chance.choice([chance.randint(-(2**63), 2**64 - 1), 2**63, 2**62, 2**61, 2**32, 2**31])
    value = int(chance.choice(bounds)) + chance.choice((-2, -1, 0, 1, 2))
    return min(max(value, -(2**63)), 2**64 - 1)


def entry(chance: random.Random) -> Any:
    """Return a payload entry: mostly an array whose dtype, shape or bytes are odd."""
    if chance.random() < 0.2:
        return chance.choice(ODD)
    code = chance.choice([*DTYPES, "|O", "<f16", "", None])
    shape = [
        chance.choice(SIZES) if chance.random() < 0.3 else chance.randint(0, 4) for _ in range(chance.randint(0, 9))
    ]
    size = chance.choice([0, 1, 8, 16, 24, 64])
    if chance.random() < 0.7 and code in DTYPES and all(type(side) is int and 0 <= side < 5 for side in shape):
        size = math.prod(shape) * DTYPES[code].itemsize
    raw = chance.randbytes(size) if size < 4096 else b""
    return [code, shape, raw][: chance.choice((3, 3, 3, 3, 2))]


def fields(chance: random.Random, sender: int) -> list[Any]:
    """Return the fields of a message of step 0, with one or a few near or beyond their bounds."""
    header = {"sequence": chance.choice([0, 10, 10**6])}
    named: dict[str, Any] = {name: header.get(name, 0) for name in Message._fields[:10]}
    named |= {"sender": sender, "stop_at": -1, "residuals": [0.5], "position": [], "payload": {}}
    for name in chance.sample(Message._fields[1:], chance.choice((1, 1, 1, 2, 3))):
        if chance.random() < 0.1:
            named[name] = chance.choice(ODD)
        elif name == "payload":
            named[name] = {chance.choice(["x", "", "states", "riding.x", "y" * 129]): entry(chance) for _ in range(3)}
        elif name in ("residuals", "position"):
            _, most, length = BOUNDS[name]
            count = chance.choice([0, 1, 2, length, length + 1] if chance.random() < 0.02 else [0, 1, 2, 17])
            named[name] = [chance.choice([0.0, -0.0, 1.0, -1.0, most, -most, math.nan, math.inf]) for _ in range(count)]
        else:
            further = {"sequence": (GAP_MAX, AHEAD_MAX), "step": (STEPS, NEVER), "incarnation": (RESTARTS_MAX,)}
            named[name] = near(chance, *BOUNDS[name][:2], 0, *further.get(name, ()))
    return [VERSION, *named.values()]


def storm(chance: random.Random, sender: int) -> bytes:
    """Return the bytes of a message near or beyond the bounds, now and then cut or with a byte changed."""
    data: bytes = msgpack.packb(fields(chance, sender))
    kind = chance.random()
    if kind < 0.05:
        return data[: chance.randrange(len(data))]
    if kind < 0.1:
        place = chance.randrange(len(data))
        return data[:place] + chance.randbytes(1) + data[place + 1 :]
    if kind < 0.11:  # lengths that nothing follows, one within the other
        return chance.choice([b"\xdd\x00\x00\x0f\xff", b"\xdd\xff\xff\xff\xff", b"\xdf\x00\x00\x0f\xff", b"\x91"]) * 600
    return data


def genuine(sender: int) -> Iterator[Message]:
    """Yield the messages of a sound sender."""
    for step in range(STEPS):
        for round in range(ROUNDS):
            payload = {"x": np.array([float(step), float(round)])}
            yield Message(
                sender, 0, step * ROUNDS + round, step, round, 10**8 * step, -1, -1, 0, Last.NO, (0.5,), (), payload
            )


def through_the_codec(chance: random.Random, count: int) -> dict[str, Any]:
    """Decode messages; anything raised but the refusal ends the program."""
    refused, slowest = 0, 0.0
    for _ in range(count):
        data = storm(chance, 2)
        began = time.process_time()
        try:
            decode(data)
        except MessageError:
            refused += 1
        slowest = max(slowest, time.process_time() - began)
    return {"refused": refused, "slowest": slowest}


def _put(mailbox: Mailbox, message: Message) -> bool:
    """Put in a message of agent 2; others are refused where the key that they came by is known."""
    if message.sender != 2:
        raise MessageError(f"it claims to come from agent {message.sender}")
    return mailbox.put(message, 0)


def through_the_receiver(chance: random.Random, count: int) -> dict[str, Any]:
    """Put messages into a mailbox among those of a sound flight, and let the receiver read them."""
    mailbox = Mailbox([2], limits=Limits(STEPS, ROUNDS))
    receiver = Receiver(mailbox, hold=True, log_all=False)
    found: Counter[str] = Counter()
    slowest = 0.0
    for message in genuine(2):
        if message.round == 0:
            receiver.begin(message.step, [2])
        for _ in range(count // (STEPS * ROUNDS)):
            data = storm(chance, 2)
            began = time.process_time()
            try:
                found["news" if _put(mailbox, decode(data)) else "old"] += 1
            except MessageError:
                found["refused"] += 1
            slowest = max(slowest, time.process_time() - began)
        if chance.random() < 0.01:
            mailbox.greet(2, chance.choice((1, 2**20)))  # a forged hello
        began = time.process_time()
        try:
            mailbox.put(decode(encode(message)), 0)
        except MessageError:
            found["sound, refused"] += 1
        if chance.random() < 0.3:
            mailbox.skip_gaps()
        end = receiver.round_end(message.round, NEVER // 2, NEVER // 2)
        receiver.end_round(message.round, end)
        inbox = receiver.inbox({}, frozenset(), message.round, stop=False)
        slowest = max(slowest, time.process_time() - began)
        found["received"] += bool(2 in inbox and "x" in inbox[2] and np.asarray(inbox[2]["x"])[0] == message.step)
    sound = [each for each in genuine(2) if each.step >= STEPS - 10]
    healed = 0
    for message in sound:  # the storm is over
        later = message._replace(sequence=message.sequence + 100 * ROUNDS, step=message.step)
        receiver.begin(message.step, [2])
        try:
            mailbox.put(later, 0)
        except MessageError:
            continue
        mailbox.skip_gaps()
        receiver.end_round(message.round, receiver.round_end(message.round, NEVER // 2, NEVER // 2))
        healed += 2 in receiver.inbox({}, frozenset(), message.round, stop=False)
    return {**found, "slowest": slowest, "healed": healed, "of": len(sound)}


def hello(chance: random.Random, sender: int) -> bytes:
    """A hello whose fields are near and beyond their bounds, or bytes that are none."""
    if chance.random() < 0.2:
        return chance.randbytes(chance.randrange(700))
    numbers = [chance.choice((-1, 0, 1, time.time_ns(), 2**20, 2**20 + 1, 2**62, 2**63)) for _ in range(5)]
    data: bytes = msgpack.packb([sender, "f" * chance.choice((0, 1, 64, 128, 129)), *numbers])
    return data


def request(chance: random.Random) -> bytes:
    """A request to change faults that no agent can carry out, or bytes that are none."""
    if chance.random() < 0.2:
        return chance.randbytes(chance.randrange(100))
    kind = chance.choice(("loss", "", "x" * 100, 2**63, None))
    senders = chance.choice(([], [99], [0] * 1000, "all", -1))
    data: bytes = msgpack.packb({"do": chance.choice(("set", "clear", "sink")), "senders": senders, "fault": kind})
    return data


@contextmanager
def stranger(launch: Launch) -> Iterator[zenoh.Session]:
    """Session of a program that is not part of the fleet, connected to all its agents."""
    until(lambda: launch.about.get("endpoints"), "the endpoints")
    with bare_session(*launch.about["endpoints"].values()) as session:
        yield session


def forged_goodbyes(folder: Path) -> dict[str, Any]:
    """Say in the name of agent 2, in a flight, that it has failed or landed, by numbers that are due and far ahead."""
    fleet = folder / "storm.toml"
    fleet.write_text(FLEET, encoding="utf-8")
    sent = 0
    lands = "safety.neighbour_silent.then=land"
    with Launch(fleet, folder / "run", lands) as launch, stranger(launch) as session:
        heard: list[Message] = []
        key = "dcf/storm/run/from/2/to/1"
        session.declare_subscriber(key, lambda sample: heard.append(decode(sample.payload.to_bytes())))
        publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK, express=True)
        launch.flying()
        until(lambda: heard, "a message of agent 2", 10.0)
        for kind, ahead in ((Last.FAILED, 1), (Last.LANDED, 1), (Last.FAILED, 1000), (Last.DONE, 1)):
            latest = heard[-1]
            step = NEVER if kind is Last.FAILED else latest.step + 1
            forged = latest._replace(sequence=latest.sequence + ahead, last=kind, step=step, round=0)
            publisher.put(encode(forged))
            sent += 1
            time.sleep(0.5)
        code = launch.end()
    return {"sent": sent, "code": code, "ends": [log.end["end"] if log.end else "" for log in logs_of(launch)]}


def logs_of(launch: Launch) -> list[AgentLog]:
    """Read the logs of the three agents."""
    return [AgentLog.read((launch.folder / log_name(i)).read_bytes(), log_name(i)) for i in (1, 2, 3)]


def through_a_fleet(chance: random.Random, folder: Path) -> dict[str, Any]:
    """Publish messages on the keys of a fleet that flies, until it has ended."""
    fleet = folder / "storm.toml"
    fleet.write_text(FLEET, encoding="utf-8")
    sent = 0
    with Launch(fleet, folder / "run") as launch:
        with stranger(launch) as session:
            drop = zenoh.CongestionControl.DROP
            links = [(i, j) for i in (1, 2, 3) for j in (1, 2, 3) if i != j]
            publishers = {
                link: session.declare_publisher(f"dcf/storm/run/from/{link[0]}/to/{link[1]}", congestion_control=drop)
                for link in links
            }
            deadline = time.monotonic() + 60
            while launch.process.poll() is None and time.monotonic() < deadline:
                link = chance.choice(links)
                publishers[link].put(storm(chance, link[0]))
                sent += 1
                if sent % 50 == 0:
                    session.put(f"dcf/storm/run/hello/{link[0]}/to/{link[1]}", hello(chance, link[0]))
                    session.get(f"dcf/storm/run/control/{link[1]}", lambda _reply: None, payload=request(chance))
                if sent % 20 == 0:
                    time.sleep(0.002)  # agents share this machine with the storm
        code = launch.end()
    logs = logs_of(launch)
    errors = [launch.folder / f"agent-{i}.err" for i in (1, 2, 3)]
    return {
        "sent": sent,
        "code": code,
        "ends": [log.end["end"] if log.end else "" for log in logs],
        "refused": [log.end["counts"]["refused"] if log.end else 0 for log in logs],
        "logged": [path.stat().st_size for path in errors if path.exists()],
    }


def main(folder: Path, count: int, seed: int) -> None:
    """Run all stages."""
    chance = random.Random(seed)
    stages: dict[str, Callable[[], dict[str, Any]]] = {
        "codec": lambda: through_the_codec(chance, count),
        "receiver": lambda: through_the_receiver(chance, count),
        "fleet": lambda: through_a_fleet(chance, folder),
    }
    assert len(storm(chance, 2)) < BYTES_MAX
    for name, stage in stages.items():
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        found = stage()
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        print(json.dumps({"stage": name, "grown_kib": grown, **found}), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
