"""Requests of operators to a running agent, on the wire and in the daemon: change link faults, end the flight.

Requests and answers are maps in msgpack. The log of an agent has the changes that were applied, in the same form.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from math import inf
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

import msgpack
from pydantic import Field, TypeAdapter, ValidationError

from agentd.daemon.end_requests import TAKES_NONE
from dcf_zenoh.config import LoadedFleet
from dcf_zenoh.configuration.building.fault_links import fault_of
from dcf_zenoh.configuration.checks.live_faults import refusals
from dcf_zenoh.diagnostics import listed
from dcf_zenoh.errors import ConfigurationError, MessageError
from dcf_zenoh.faults.chain import FaultChain
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.log_writer import Recorder
from dcf_zenoh.spec import AgentId, Switch, Table

LONGEST_REQUEST = 1 << 16  # bytes
LONGEST_ANSWER = 1 << 24
CHANGES_MAX = 1000  # changes of faults in one life of an agent
EVENT = "fault"  # in the log

T = TypeVar("T")
Senders = Annotated[tuple[AgentId, ...], Field(min_length=1)]


class Change(Table):
    """Apply a fault to the links from `senders` from now on, in place of an earlier change of this name."""

    do: Literal["set"] = "set"
    senders: Senders
    name: Annotated[str, Field(min_length=1, max_length=64)]
    fault: Switch


class Clear(Table):
    """End all changes of the links from `senders`."""

    do: Literal["clear"] = "clear"
    senders: Senders


class Show(Table):
    """Return the changes applied so far."""

    do: Literal["show"] = "show"


class Land(Table):
    """End the flight."""

    do: Literal["land"] = "land"


class Halt(Table):
    """Stop the motors at once. It reaches the body past the loop, which then ends and answers."""

    do: Literal["stop"] = "stop"


class AppliedChange(Table):
    """Change that an agent has applied.

    Attributes:
        time: When it was applied, fleet time in ns.
        change: The request.
    """

    time: Annotated[int, Field(ge=0)]
    change: Annotated[Change | Clear, Field(discriminator="do")]


class Answer(Table):
    """Answer of an agent.

    Attributes:
        agent: Id of the agent.
        time: Fleet time, ns.
        error: Why it has refused the request; empty if it has carried it out.
        senders: Senders of the links that have changed.
        changes: Changes applied so far, in answer to `Show`.
    """

    agent: AgentId
    time: Annotated[int, Field(ge=0)] = 0
    error: str = ""
    senders: tuple[AgentId, ...] = ()
    changes: tuple[AppliedChange, ...] = ()


OperatorRequest: TypeAlias = Change | Clear | Show | Land | Halt
_REQUEST: TypeAdapter[OperatorRequest] = TypeAdapter(Annotated[OperatorRequest, Field(discriminator="do")])
_ANSWER = TypeAdapter(Answer)
_APPLIED = TypeAdapter(AppliedChange)


def _plain(item: Table) -> dict[str, Any]:
    return item.model_dump(exclude_none=True, mode="json")


def encode(item: Table) -> bytes:
    """Encode a request or an answer as bytes."""
    data: bytes = msgpack.packb(_plain(item))
    return data


HALT = encode(Halt())


def decode_request(data: bytes) -> OperatorRequest:
    """Decode a request.

    Raises:
        MessageError: The bytes are not a request.
    """
    return _decode(data, _REQUEST, LONGEST_REQUEST, "a request")


def decode_answer(data: bytes, agent: int) -> Answer:
    """Decode an answer of `agent`; an empty one means that it takes no requests now.

    Raises:
        MessageError: The bytes are not an answer.
    """
    if not data:
        return Answer(agent=agent, error=TAKES_NONE)
    return _decode(data, _ANSWER, LONGEST_ANSWER, "an answer")


def changes_in(log: AgentLog) -> tuple[AppliedChange, ...]:
    """Return the changes in the log of an agent, in the order of time.

    Raises:
        MessageError: An entry of the log is not a change.
    """
    found = [each for each in log.events if each["event"] == EVENT]
    return tuple(
        _check({"time": each["time"], "change": each.get("change")}, _APPLIED, "a change of faults") for each in found
    )


class Control:
    """Carries out operators' requests to one agent.

    Args:
        agent: Id of the agent.
        fleet: Its fleet.
        neighbours: Its in-neighbours.
        links: Neighbour -> fault chain of the link from it, as the agent uses it; missing ones are added.
        recorder: Its log.
        end: Ends the flight, for a reason in words.
    """

    def __init__(
        self,
        agent: int,
        fleet: LoadedFleet,
        neighbours: tuple[int, ...],
        links: dict[int, FaultChain],
        recorder: Recorder,
        end: Callable[[str], None],
    ) -> None:
        self._agent = agent
        self._fleet = fleet
        self._neighbours = neighbours
        self._links = links
        self._recorder = recorder
        self._end = end
        self._applied: list[AppliedChange] = []

    def handle(self, data: bytes, now: int) -> bytes:
        """Carry out a request as a whole, or nothing of it.

        Args:
            data: The request.
            now: Fleet time, ns.

        Returns:
            The answer.

        Raises:
            RecordingError: The log cannot be written.
        """
        try:
            request = decode_request(data)
            if isinstance(request, Show):
                return encode(Answer(agent=self._agent, time=now, changes=tuple(self._applied)))
            if isinstance(request, Land | Halt):
                self._end("landed by an operator" if isinstance(request, Land) else "emergency stop by an operator")
                return encode(Answer(agent=self._agent, time=now))
            self._apply(applied := AppliedChange(time=now, change=request))
        except (MessageError, ConfigurationError) as error:
            return encode(Answer(agent=self._agent, time=now, error=str(error)))
        self._recorder.event(EVENT, now, change=_plain(applied.change))
        return encode(Answer(agent=self._agent, time=now, senders=request.senders))

    def restore(self, changes: Iterable[AppliedChange]) -> None:
        """Apply again the changes of an earlier incarnation of this agent.

        Raises:
            ConfigurationError: A change is no longer possible.
        """
        for applied in changes:
            self._apply(applied)

    def _apply(self, applied: AppliedChange) -> None:
        what = applied.change
        if len(self._applied) >= CHANGES_MAX:
            raise ConfigurationError(f"agent {self._agent} has changed its faults {CHANGES_MAX} times, and no more")
        if strangers := sorted(set(what.senders) - set(self._neighbours)):
            raise MessageError(
                f"agent {self._agent} does not hear {listed(strangers)}; it hears {listed(self._neighbours)}"
            )
        if isinstance(what, Clear):
            for j in what.senders:
                if j in self._links:
                    self._links[j].clear(applied.time)
        else:
            spec, folder, name = self._fleet.spec, self._fleet.folder, what.name
            if problems := refusals(spec, folder, name, what.fault):
                raise ConfigurationError(problems)
            faults = {j: fault_of(name, what.fault, j, self._agent, folder) for j in what.senders}
            for j, fault in faults.items():
                link = self._links.setdefault(j, FaultChain(spec.seed, j, self._agent))
                link.add(name, (applied.time, inf), fault)
        self._applied.append(applied)


def _decode(data: bytes, adapter: TypeAdapter[T], longest: int, what: str) -> T:
    if len(data) > longest:
        raise MessageError(f"not {what}: {len(data)} bytes, at most {longest} are allowed")
    try:
        found = msgpack.unpackb(data)
    except (ValueError, msgpack.UnpackException) as error:
        raise MessageError(f"not {what}: not msgpack: {error}") from error
    return _check(found, adapter, what)


def _check(found: object, adapter: TypeAdapter[T], what: str) -> T:
    if not isinstance(found, Mapping):
        raise MessageError(f"not {what}: expected a map, not {type(found).__name__}")
    try:  # strict JSON has neither bytes nor numbers in strings
        return adapter.validate_json(json.dumps(found, allow_nan=False), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(map(str, first["loc"])) or "do"
        raise MessageError(f"not {what}: {place}: {first['msg']}") from error
    except (TypeError, ValueError, RecursionError) as error:
        raise MessageError(f"not {what}: {error}") from error
