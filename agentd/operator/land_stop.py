"""``agentd land`` and ``agentd stop``: end a flight from outside."""

import sys
from typing import Literal

from agentd.daemon.operator_protocol import HALT, Land, decode_answer, encode
from agentd.operator.query import ask
from agentd.operator.running_fleet import RunningFleet, find_run
from dcf_zenoh.errors import ConfigurationError, MessageError

TIMEOUT = 3.0  # s for all answers


def order(name: str, what: Literal["land", "stop"]) -> int:
    """Tell all agents of a run; the exit code, 1 if one does not answer.

    Args:
        name: Of a run directory, or of a fleet.
        what: The order.

    Raises:
        ConfigurationError: The run is over.
        RecordingError: There is no such run.
        NetworkError: Zenoh cannot be opened.
    """
    folder = find_run(name)
    run = RunningFleet.read(folder)
    if run.over:
        raise ConfigurationError("this run is over", str(folder))
    request = HALT if what == "stop" else encode(Land())
    answers = ask(run.address, dict.fromkeys(run.fleet.spec.ids, request), TIMEOUT)
    complaints = []
    for agent in run.fleet.spec.ids:
        try:
            said = decode_answer(answers[agent], agent).error if agent in answers else None
        except MessageError as error:
            said = str(error)
        if said is None:
            complaints.append(f"agent {agent} did not answer within {TIMEOUT:g} s")
        elif said:
            complaints.append(f"agent {agent}: {said}")
        else:
            print(f"agent {agent}: {'lands' if what == 'land' else 'motors off'}")
    for line in complaints:
        print(f"agentd: {line}", file=sys.stderr)
    return 1 if complaints else 0
