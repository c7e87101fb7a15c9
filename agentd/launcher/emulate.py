"""``agentd emulate-crazyflie``: software Crazyflies that cflib connects to."""

import math
import signal
import sys
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING
from urllib.parse import urlparse

import numpy as np

from dcf_zenoh.config import Overrides, load
from dcf_zenoh.errors import ConfigurationError

if TYPE_CHECKING:
    from plants.crazyflie.emulator.fleet import Place


class Signals:
    """Turns SIGINT and SIGTERM into a word to look at."""

    def __init__(self) -> None:
        self.came = False

    def __call__(self, _signum: int, _frame: FrameType | None) -> None:
        """A signal has come."""
        self.came = True


def emulate(options: Namespace) -> int:
    """Let drones live until a signal comes, or whoever started them has gone; the exit code.

    Raises:
        ConfigurationError: An option, or the fleet, is not usable.
    """
    from plants.crazyflie.emulator.fleet import Emulation  # noqa: PLC0415 - compiles; whoever does something else need not wait
    from plants.crazyflie.emulator.radio import RadioConditions  # noqa: PLC0415
    from plants.crazyflie.emulator.server import serve  # noqa: PLC0415

    air = RadioConditions(latency=options.latency, tail=options.tail, silences=options.silences, loss=options.loss)
    with heeding() as signals:
        try:
            emulation = Emulation(
                places(options),
                parameters=options.parameters,
                sensing=options.sensing,
                conditions=air,
                truth=options.truth,
                seed=options.seed or 0,
            )
        except OSError as error:
            raise ConfigurationError(f"emulate-crazyflie: {error.filename}: {error.strerror}") from error
        except ValueError as error:
            raise ConfigurationError(f"emulate-crazyflie: {error}") from error
        with emulation:
            for number, drone in emulation.drones.items():
                print(f"ready {number} {drone.endpoint.uri}", flush=True)
            serve(
                emulation.drones,
                emulation.begin,
                lambda: signals.came,
                lines=sys.stdin,
                until_closed=options.until_stdin_closes,
            )
    return 0


def places(options: Namespace) -> "dict[int, Place]":
    """Where the drones stand and listen: those of a fleet, or `options.n` of them.

    Raises:
        ConfigurationError: No agent of the fleet has a URI that can be emulated, or a number is out of its range.
    """
    from plants.crazyflie.emulator.fleet import Place, default_positions  # noqa: PLC0415

    if not 0 <= options.loss <= 1:
        raise ConfigurationError(f"emulate-crazyflie: expected --loss from 0 to 1, not {options.loss:g}")
    for name in ("latency", "tail", "silences"):
        if not 0 <= getattr(options, name) < math.inf:
            raise ConfigurationError(f"emulate-crazyflie: expected --{name} >= 0, not {getattr(options, name):g}")
    if options.fleet is None:
        if not 1 <= options.n <= 100 or not 0 <= options.port <= 65536 - options.n:
            raise ConfigurationError("emulate-crazyflie: expected --n from 1 to 100, and --port so that all have one")
        return {
            k + 1: Place(position, port=options.port and options.port + k, tcp=options.tcp)
            for k, position in enumerate(default_positions(options.n))
        }
    spec = load(options.fleet, Overrides(plant=options.plant)).spec
    found = {}
    for i in spec.ids:
        agent = spec.agent(i)
        uri = urlparse(str(agent.plant.options.get("uri", "")) if agent.plant else "")
        if uri.scheme in ("udp", "tcp") and uri.hostname and uri.port:
            found[i] = Place(np.array(agent.start[:2]), host=uri.hostname, port=uri.port, tcp=uri.scheme == "tcp")
    if not found:
        raise ConfigurationError(
            "no agent has a plant with a uri of udp:// or tcp:// that could be emulated; --plant may choose another",
            options.fleet,
        )
    return found


@contextmanager
def heeding() -> Iterator[Signals]:
    """Within, SIGINT and SIGTERM only set a mark, and a terminal may be in use by somebody else."""
    signals = Signals()
    before = {each: signal.signal(each, signals) for each in (signal.SIGINT, signal.SIGTERM)}
    before[signal.SIGTTIN] = signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    try:
        yield signals
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
