"""``agentd land`` and ``agentd stop``: end the flight of a running fleet."""

from typing import Literal

from agentd.daemon.operator_protocol import HALT, Land, encode
from agentd.operator.query import print_complaints, query_agents
from agentd.operator.running_fleet import RunningFleet, find_run
from dcf_zenoh.errors import ConfigurationError


def end_flight(name: str, how: Literal["land", "stop"]) -> int:
    """Make all agents of a run land or stop their motors; return the exit code, 1 if an agent does not answer.

    Args:
        name: Run directory, or name of a fleet.
        how: Whether to land or to stop all motors at once.

    Raises:
        ConfigurationError: The run is over.
        RecordingError: There is no such run.
        NetworkError: Zenoh cannot be opened.
    """
    folder = find_run(name)
    run = RunningFleet.read(folder)
    if run.over:
        raise ConfigurationError("this run is over", str(folder))
    request = HALT if how == "stop" else encode(Land())
    answers, complaints = query_agents(run.address, dict.fromkeys(run.fleet.spec.ids, request))
    for agent in answers:
        print(f"agent {agent}: {'lands' if how == 'land' else 'motors off'}")
    return print_complaints(complaints)
