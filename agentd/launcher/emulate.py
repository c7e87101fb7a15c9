"""``agentd emulate-crazyflie``: software Crazyflies that cflib connects to."""

import math
import signal
import sys
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from urllib.parse import urlparse

import numpy as np

from dcf_zenoh.config import Overrides, load
from dcf_zenoh.errors import ConfigurationError
from plants.crazyflie.emulator.fleet import Emulation, Place, default_positions
from plants.crazyflie.emulator.radio import RadioConditions
from plants.crazyflie.emulator.server import serve


class SignalFlag:
    """Signal handler that records that a signal was received."""

    def __init__(self) -> None:
        self.received = False

    def __call__(self, _signum: int, _frame: FrameType | None) -> None:
        """Record the signal."""
        self.received = True


def emulate(options: Namespace) -> int:
    """Run drones until SIGINT, SIGTERM or, if asked for, the end of standard input; return the exit code.

    Raises:
        ConfigurationError: An option or the fleet cannot be used.
    """
    conditions = RadioConditions(
        latency=options.latency, tail=options.tail, silences=options.silences, loss=options.loss
    )
    with signals_recorded() as signals:
        try:
            emulation = Emulation(
                places(options),
                parameters=options.parameters,
                sensing=options.sensing,
                conditions=conditions,
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
                lambda: signals.received,
                lines=sys.stdin,
                until_closed=options.until_stdin_closes,
            )
    return 0


def places(options: Namespace) -> dict[int, Place]:
    """Return number -> place of each drone: of the agents of a fleet that have a URI, or of `options.n` drones.

    Raises:
        ConfigurationError: No agent of the fleet has a URI that can be emulated, or a number is out of its range.
    """
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
def signals_recorded() -> Iterator[SignalFlag]:
    """Record SIGINT and SIGTERM within the context instead of ending the process.

    SIGTTIN is ignored, so that a process in the background is not stopped when it reads from the terminal.
    """
    flag = SignalFlag()
    before = {each: signal.signal(each, flag) for each in (signal.SIGINT, signal.SIGTERM)}
    before[signal.SIGTTIN] = signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    try:
        yield flag
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
