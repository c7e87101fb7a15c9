"""Text commands to running emulated drones: one line, one answer."""

import json
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from plants.crazyflie.emulator.drone import Drone
from plants.crazyflie.emulator.truth import rounded

ENDLESS = float("inf")
STATIONS_MAX = 16  # base stations of a Lighthouse system


class CommandError(ValueError):
    """Line that is not a command; the message says what is expected."""


class Verb(NamedTuple):
    """One kind of command.

    Attributes:
        usage: Arguments of the command, as help text.
        run: Executes the command on a drone at an instant, s, and returns the answer.
    """

    usage: str
    run: Callable[[Drone, float, list[str]], str]


def execute(line: str, drones: Mapping[int, Drone], now: float) -> str:
    """Execute a line at `now`, s: ``DRONE VERB [VALUE ...]``, with 'all' for all drones.

    Returns:
        The answer: 'ok' and the line, or the states of the drones.

    Raises:
        CommandError: The line is not a command.
    """
    words = line.split()
    if len(words) < 2 or words[1] not in VERBS:
        raise CommandError(f"expected DRONE {'|'.join(VERBS)}, not {line.strip()!r}")
    chosen = list(drones.items()) if words[0] == "all" else [(i, d) for i, d in drones.items() if str(i) == words[0]]
    if not chosen:
        raise CommandError(f"there is no drone {words[0]}; there are {', '.join(map(str, drones))}")
    verb = VERBS[words[1]]
    try:
        answers = [verb.run(drone, now, words[2:]) for _, drone in chosen]
    except (ValueError, IndexError) as error:
        raise CommandError(f"expected DRONE {words[1]} {verb.usage}, not {line.strip()!r}") from error
    return " ".join(answers) if words[1] == "state" else f"ok {line.strip()}"


def _battery(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.firmware.battery.set(_number(words[0], least=0.0))
    return ""


def _silence(drone: Drone, now: float, words: list[str]) -> str:
    drone.radio.silence(now, _number(words[0], least=0.0))
    return ""


def _kill_link(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.radio.silence(now, ENDLESS)
    return ""


def _restore_link(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.restore(now)
    return ""


def _loss(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.radio.loss = _number(words[0], least=0.0, most=1.0)
    return ""


def _refuse_arm(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.firmware.healthy = not _switched_on(words)
    return ""


def _tumble(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.firmware.upside_down = _switched_on(words)
    return ""


def _variance(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.firmware.estimator.fixed_variance = None if words[0] == "off" else _number(words[0], least=0.0)
    return ""


def _freeze(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.firmware.estimator.frozen = _switched_on(words)
    return ""


def _stations(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.firmware.lighthouse.received = (1 << int(_number(words[0], least=0, most=STATIONS_MAX))) - 1
    return ""


def _deck_silent(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.firmware.lighthouse.silent = _switched_on(words)
    return ""


def _auto_arm(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.firmware.automatic = _switched_on(words)
    return ""


def _drift(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.firmware.body.push = np.array([_number(words[0]), _number(words[1])])
    return ""


def _place(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    x, y, *yaw = (_number(word) for word in words)
    drone.firmware.place(np.array([x, y]), np.radians(yaw[0]) if yaw else 0.0)
    return ""


def _restart(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    drone.ports.restart()
    return ""


def _state(drone: Drone, now: float, words: list[str]) -> str:  # noqa: ARG001
    firmware = drone.firmware
    return json.dumps(
        {
            "time": firmware.now / 1000,
            "position": rounded(firmware.body.position),
            "velocity": rounded(firmware.body.velocity),
            "supervisor": firmware.supervisor.state.value,
            "armed": firmware.supervisor.armed,
            "battery": round(firmware.battery.voltage, 3),
        }
    )


def _switched_on(words: list[str]) -> bool:
    """Return whether the argument is 'on' or missing.

    Raises:
        ValueError: The argument is neither 'on' nor 'off'.
    """
    if words not in ([], ["on"], ["off"]):
        raise ValueError(words)
    return words != ["off"]


def _number(word: str, least: float = -ENDLESS, most: float = ENDLESS) -> float:
    """Read a finite number within a range.

    Raises:
        ValueError: The word is not such a number.
    """
    number = float(word)
    if not math.isfinite(number) or not least <= number <= most:
        raise ValueError(word)
    return number


VERBS = {
    "battery": Verb("VOLTS", _battery),
    "silence": Verb("SECONDS", _silence),
    "kill-link": Verb("", _kill_link),
    "restore-link": Verb("", _restore_link),
    "loss": Verb("PROBABILITY (0 to 1)", _loss),
    "refuse-arm": Verb("[on|off]", _refuse_arm),
    "tumble": Verb("[on|off]", _tumble),
    "variance": Verb("SQUARE_METRES|off", _variance),
    "freeze-estimate": Verb("[on|off]", _freeze),
    "base-stations": Verb("NUMBER (0 to 16)", _stations),
    "deck-silent": Verb("[on|off]", _deck_silent),
    "auto-arm": Verb("[on|off]", _auto_arm),
    "drift": Verb("VX VY", _drift),
    "place": Verb("X Y [YAW_DEGREES]", _place),
    "restart": Verb("", _restart),
    "state": Verb("", _state),
}
