"""Emulated drones in real time: one process, one thread, one loop."""

import os
import select
import time
from collections.abc import Callable, Mapping
from typing import Any, TextIO

from plants.crazyflie.emulator.console import Misunderstood, obey
from plants.crazyflie.emulator.drone import Drone

LONGEST = 0.1  # s between two looks at `stop`


def serve(
    drones: Mapping[int, Drone],
    begin: float,
    stop: Callable[[], bool],
    *,
    lines: TextIO | None,
    until_closed: bool = False,
) -> None:
    """Let drones live until `stop` says so, or a line ``quit`` comes.

    Args:
        drones: By the numbers that they go by in commands.
        begin: Instant of the monotonic clock, s, that is their time 0.
        stop: Whether it is over.
        lines: Where commands come from, if from anywhere; each is answered by a line on standard output.
        until_closed: The end of `lines` is the end of the drones.
    """
    talk = lines
    unfinished = ""
    while not stop():
        readers: list[Any] = [each for drone in drones.values() for each in drone.endpoint.sockets()]
        if talk is not None:
            readers.append(talk)
        pause = min(drone.next for drone in drones.values()) - (time.monotonic() - begin)
        heard = set(select.select(readers, [], [], min(LONGEST, max(0.0, pause)))[0])
        now = time.monotonic() - begin
        for drone in drones.values():
            if drone.next <= now or not heard.isdisjoint(drone.endpoint.sockets()):
                drone.run(now)
        if talk is not None and talk in heard:
            text = _read(talk)
            if not text:
                talk = None
                if until_closed:
                    return
            *complete, unfinished = (unfinished + text).split("\n")
            for line in complete:
                if line.strip() == "quit":
                    return
                if line.strip():
                    _answer(line, drones, now)


def _answer(line: str, drones: Mapping[int, Drone], now: float) -> None:
    try:
        answer = obey(line, drones, now)
    except Misunderstood as error:
        answer = f"error: {error}"
    print(answer, flush=True)


def _read(talk: TextIO) -> str:
    """What has come, without waiting for the end of a line; empty at the end of it all."""
    try:
        return os.read(talk.fileno(), 65536).decode(errors="replace")
    except OSError:
        return ""
