"""Server of emulated drones in real time: one process, one thread, one loop."""

import os
import select
import time
from collections.abc import Callable, Mapping
from typing import Any, TextIO

from plants.crazyflie.emulator.console import CommandError, execute
from plants.crazyflie.emulator.drone import Drone

LONGEST = 0.1  # s between two calls of `stop`


def serve(
    drones: Mapping[int, Drone],
    begin: float,
    stop: Callable[[], bool],
    *,
    lines: TextIO | None,
    until_closed: bool = False,
) -> None:
    """Run drones until `stop` returns True, or a line ``quit`` is read.

    Args:
        drones: Number in commands -> drone.
        begin: Instant of the monotonic clock, s, that is time 0 of the drones.
        stop: Returns whether to end.
        lines: Source of commands, or None; each is answered by a line on standard output.
        until_closed: End when `lines` is closed.
    """
    commands = lines
    unfinished = ""
    while not stop():
        readers: list[Any] = [each for drone in drones.values() for each in drone.endpoint.sockets()]
        if commands is not None:
            readers.append(commands)
        pause = min(drone.next for drone in drones.values()) - (time.monotonic() - begin)
        ready = set(select.select(readers, [], [], min(LONGEST, max(0.0, pause)))[0])
        now = time.monotonic() - begin
        for drone in drones.values():
            if drone.next <= now or not ready.isdisjoint(drone.endpoint.sockets()):
                drone.run(now)
        if commands is not None and commands in ready:
            text = _read_available(commands)
            if not text:
                commands = None
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
        answer = execute(line, drones, now)
    except CommandError as error:
        answer = f"error: {error}"
    print(answer, flush=True)


def _read_available(commands: TextIO) -> str:
    """Read what is available, without waiting for the end of a line; empty at the end of the stream."""
    try:
        return os.read(commands.fileno(), 65536).decode(errors="replace")
    except OSError:
        return ""
