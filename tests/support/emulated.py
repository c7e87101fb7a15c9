"""One software Crazyflie in a process of its own, a link that loses packets, and what the drone really did."""

import json
import select
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from plants.crazyflie.emulator.truth import Record
from tests.support.emulator_process import EmulatorProcess

# Before each test: as it was switched on, whatever was done to it before.
AFRESH = (
    "restore-link",
    "loss 0",
    "refuse-arm off",
    "tumble off",
    "variance off",
    "freeze-estimate off",
    "deck-silent off",
    "auto-arm off",
    "base-stations 2",
    "drift 0 0",
    "restart",
    "battery 4.1",
)


def drive(pauses: Iterator[float] | Any, within: float = 40.0) -> float:
    """Run a phase of a plant to its end; the seconds that it took."""
    began = time.monotonic()
    for pause in pauses or ():
        assert time.monotonic() - began < within, f"the phase does not end within {within:g} s"
        time.sleep(pause)  # as the phase asks for
    return time.monotonic() - began


class Emulated(EmulatorProcess):
    """One drone of ``agentd emulate-crazyflie``. Use it in a ``with`` statement.

    Args:
        folder: Where it writes the truth.
        options: Other options of the command.
    """

    def __init__(self, folder: Path, *options: str) -> None:
        self._path = folder / "drone-1.jsonl"
        self._read, self._rest = 0, b""
        self._records: list[Record] = []
        super().__init__(folder, 1, *options)
        self.uri = self.uris[1]

    def say(self, line: str) -> str:
        """Send it a line such as ``battery 3.0``; its answer."""
        return self.send(1, line)

    def renew(self, x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> None:
        """Switch it off and on, standing there (m, m, deg); what it did before is not told any more."""
        for line in (*AFRESH, f"place {x} {y} {yaw}"):
            self.say(line)
        since = self.state["time"]
        self._records = [record for record in self.truth if record.time > since]

    @property
    def state(self) -> dict[str, Any]:
        """What is so now: time, position, velocity, supervisor, armed, battery."""
        found: dict[str, Any] = json.loads(self.say("state"))
        return found

    @property
    def truth(self) -> list[Record]:
        """What it did and was told, so far."""
        with self._path.open("rb") as stream:  # only what is new: it becomes long
            stream.seek(self._read)
            data = stream.read()
        self._read += len(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        for fields in map(json.loads, lines):
            self._records.append(Record(fields.pop("kind"), fields.pop("time"), fields))
        return list(self._records)

    @property
    def events(self) -> list[str]:
        """What happened to it, in order."""
        return [record["event"] for record in self.truth if record.kind == "event"]

    @property
    def path(self) -> "np.ndarray[Any, np.dtype[np.float64]]":
        """Time and true position, shape (samples, 4), s and m."""
        states = [record for record in self.truth if record.kind == "state"]
        return np.array([(record.time, *record["position"]) for record in states])

    def commands(self, *names: str) -> list[Record]:
        """What it was told, in order; all, or those of some names."""
        told = [record for record in self.truth if record.kind == "command"]
        return [record for record in told if not names or record["command"] in names]

    def landed_softly(self) -> bool:
        """It came down as it should, with its motors running, and never lost control."""
        touched = [record for record in self.truth if record.kind == "event" and record["event"] == "touched down"]
        lost = {"free fall", "locked", "crashed", "emergency stop"} & set(self.events)
        return bool(touched) and all(record["soft"] for record in touched) and not lost


class Relay:
    """A UDP port in front of another that loses some of the packets, each way. Use it in a ``with`` statement.

    Args:
        uri: Of the drone.
        loss: Probability.
        seed: Of the losses.
    """

    def __init__(self, uri: str, loss: float, seed: int = 0) -> None:
        host, _, port = uri.removeprefix("udp://").partition(":")
        self._loss = loss
        self._rng = np.random.default_rng(seed)
        self._client: Any = None
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind(("127.0.0.1", 0))
        self._far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._far.connect((host, int(port)))
        self.uri = f"udp://127.0.0.1:{self._near.getsockname()[1]}"
        self.questions: list[bytes] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join(5)
        self._near.close()
        self._far.close()

    def _run(self) -> None:
        while not self._ended.is_set():
            ready, _, _ = select.select([self._near, self._far], [], [], 0.1)
            for each in ready:
                packet, sender = each.recvfrom(64)
                if each is self._near:
                    self._client = sender
                    self.questions.append(packet)
                if self._rng.random() < self._loss:
                    continue
                if each is self._near:
                    self._far.send(packet)
                elif self._client is not None:
                    self._near.sendto(packet, self._client)
