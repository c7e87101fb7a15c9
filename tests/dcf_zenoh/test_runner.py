"""Dispatch of requests to the methods of a runner, and `drive`, with a runner that records what it is asked for."""

from typing import get_args

import numpy as np
import pytest

from dcf_zenoh.errors import DcfError, Stopped
from dcf_zenoh.message import Last, Message
from dcf_zenoh.requests import Activate, Agree, Loop, Publish, Report, Request, Start, Wait
from dcf_zenoh.runner import Runner, drive

MESSAGE = Message(1, 0, 0, 0, 0, 0, -1, -1, 0, Last.NO, (), (), {})
REQUESTS: dict[str, Request] = {
    "publish": Publish(MESSAGE),
    "wait": Wait(5),
    "activate": Activate(6, (2,)),
    "start": Start(7),
    "report": Report("arm"),
    "agree": Agree(8),
}


class Recording(Runner):
    """Records the name of each method that is called, and its request; counts the calls as fleet time."""

    def __init__(self, failing: str = "") -> None:
        super().__init__()
        self.calls: list[tuple[str, Request]] = []
        self.failing = failing

    def record(self, name: str, request: Request) -> int:
        if name == self.failing:
            raise Stopped("stopped by the test")
        self.calls.append((name, request))
        return len(self.calls)

    def publish(self, request: Publish) -> int:
        return self.record("publish", request)

    def wait(self, request: Wait) -> int:
        return self.record("wait", request)

    def activate(self, request: Activate) -> int:
        return self.record("activate", request)

    def start(self, request: Start) -> int:
        return self.record("start", request)

    def report(self, request: Report) -> int:
        return self.record("report", request)

    def agree(self, request: Agree) -> int:
        return self.record("agree", request)


def test_each_request_is_answered_by_its_method() -> None:
    runner = Recording()
    assert [runner.answer(request) for request in REQUESTS.values()] == [1, 2, 3, 4, 5, 6]
    assert runner.calls == list(REQUESTS.items())
    assert {type(request) for request in REQUESTS.values()} == set(get_args(Request))


def test_drive_resumes_the_loop_with_the_answers_and_returns_its_result() -> None:
    def loop() -> Loop[list[int]]:
        first = yield REQUESTS["wait"]
        second = yield REQUESTS["publish"]
        return [first, second]

    assert drive(loop(), Recording()) == [1, 2]


def test_error_of_a_runner_reaches_the_loop_at_its_request() -> None:
    def loop() -> Loop[str]:
        yield REQUESTS["publish"]
        try:
            yield REQUESTS["wait"]
        except Stopped as error:
            yield REQUESTS["report"]  # for example to land
            return str(error)
        return "not stopped"

    runner = Recording(failing="wait")
    assert drive(loop(), runner) == "stopped by the test"
    assert [name for name, _ in runner.calls] == ["publish", "report"]


def test_error_that_the_loop_does_not_handle_ends_drive() -> None:
    def loop() -> Loop[None]:
        yield REQUESTS["wait"]

    with pytest.raises(DcfError, match="stopped by the test"):
        drive(loop(), Recording(failing="wait"))


def test_numpy_does_not_warn_within_a_loop() -> None:
    def loop() -> Loop[float]:
        yield REQUESTS["wait"]
        return float((np.array([1e308]) * 10 - np.array([np.inf]))[0])

    assert np.isnan(drive(loop(), Recording()))
