"""``agentd emulate-crazyflie``: software Crazyflies that cflib connects to."""

import signal
from argparse import Namespace
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING
from urllib.parse import urlparse

from dcf_zenoh.config import load
from dcf_zenoh.errors import ConfigurationError

if TYPE_CHECKING:
    from plants.emulator.fleet import Place


class Signals:
    """Turns SIGINT and SIGTERM into a word to look at."""

    def __init__(self) -> None:
        self.came = False

    def __call__(self, signum: int, frame: FrameType | None) -> None:
        """A signal has come."""
        self.came = True


def emulate(options: Namespace) -> int:
    """Let drones live until a signal comes, or whoever started them has gone; the exit code.

    Raises:
        ConfigurationError: An option, or the fleet, is not usable.
    """
    from plants.emulator.fleet import Emulation  # noqa: PLC0415 - compiles; whoever does something else need not wait
    from plants.emulator.radio import Air  # noqa: PLC0415
    from plants.emulator.server import serve  # noqa: PLC0415

    air = Air(latency=options.latency, tail=options.tail, silences=options.silences, loss=options.loss)
    with heeding() as signals:
        try:
            emulation = Emulation(
                places(options),
                parameters=options.parameters,
                sensing=options.sensing,
                air=air,
                truth=options.truth,
                seed=options.seed or 0,
            )
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"emulate-crazyflie: {error}") from error
        with emulation:
            for number, drone in emulation.drones.items():
                print(f"ready {number} {drone.endpoint.uri}", flush=True)
            serve(
                emulation.drones, emulation.begin, lambda: signals.came, until_closed=options.until_stdin_closes
            )
    return 0


def places(options: Namespace) -> "Mapping[int, Place]":
    """Where the drones stand and listen: those of a fleet, or `options.n` of them.

    Raises:
        ConfigurationError: The fleet's plant has no URIs that can be emulated.
    """
    from plants.emulator.fleet import Place, around  # noqa: PLC0415

    if options.fleet is None:
        standing = around(options.n)
        return {
            k + 1: Place(position, port=options.port + k, tcp=options.tcp) for k, position in enumerate(standing)
        }
    spec = load(options.fleet, plant=options.plant or "hardware").spec
    found = {}
    for i, agent in spec.agents.items():
        uri = agent.plant.options.get("uri", "") if agent.plant else ""
        parsed = urlparse(str(uri))
        if parsed.scheme not in ("udp", "tcp") or not parsed.port:
            raise ConfigurationError(
                f"agent {i}: its URI must begin with udp:// or tcp:// and name a port, not {uri!r}", options.fleet
            )
        found[i] = Place(agent.start[:2], host=parsed.hostname or "", port=parsed.port, tcp=parsed.scheme == "tcp")
    return found


@contextmanager
def heeding() -> Iterator[Signals]:
    """Within, SIGINT and SIGTERM only set a mark."""
    signals = Signals()
    before = {each: signal.signal(each, signals) for each in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield signals
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
