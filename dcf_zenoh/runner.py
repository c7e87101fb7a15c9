"""Interface of what drives an agent's loop: one method per request, and the dispatch that all runners share.

Runners: `WallRunner` and `VirtualRunner` of a daemon (`agentd.daemon.runner`), and each agent of the simulator.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from dcf_zenoh.requests import Activate, Agree, Loop, Publish, Report, Request, Start, Wait

R = TypeVar("R")


def quiet_arithmetic() -> np.errstate:
    """Return a context in which numpy does not warn of overflow and NaN: the loop checks its numbers itself."""
    return np.errstate(over="ignore", invalid="ignore")


class Runner(ABC):
    """Runner of one agent's loop.

    The method of a request does what the request asks for and returns the fleet time afterwards, ns.
    """

    def __init__(self) -> None:
        self._methods: dict[type[Request], Callable[[Any], int]] = {
            Publish: self.publish,
            Wait: self.wait,
            Activate: self.activate,
            Start: self.start,
            Report: self.report,
            Agree: self.agree,
        }

    def answer(self, request: Request) -> int:
        """Do what `request` asks for; return the fleet time, ns, with which to resume the loop."""
        return self._methods[type(request)](request)

    @abstractmethod
    def publish(self, request: Publish) -> int:
        """Send a message."""

    @abstractmethod
    def wait(self, request: Wait) -> int:
        """Wait for an instant, or for messages of a round."""

    @abstractmethod
    def activate(self, request: Activate) -> int:
        """Wait for the instant of an activation."""

    @abstractmethod
    def start(self, request: Start) -> int:
        """Start fleet time."""

    @abstractmethod
    def report(self, request: Report) -> int:
        """Pass on a phase of the flight."""

    @abstractmethod
    def agree(self, request: Agree) -> int:
        """Wait for a person's consent to the take-off; return -1 when it has not come in time."""


def drive(loop: Loop[R], runner: Runner) -> R:
    """Drive `loop` to its end and return its result.

    An exception that `runner` raises is thrown into the loop at the request that it could not answer: the loop may
    have to act before it ends, for example to land.

    Raises:
        DcfError: The error that stopped the loop.
    """
    answer = runner.answer
    try:
        with quiet_arithmetic():
            request = next(loop)
            while True:
                try:
                    now = answer(request)
                except Exception as error:
                    request = loop.throw(error)
                else:
                    request = loop.send(now)
    except StopIteration as finished:
        result: R = finished.value
        return result
