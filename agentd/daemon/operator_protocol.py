"""What operators ask of an agent while the fleet flies: what is said on the wire, and what the daemon does.

Faults can be changed, and the flight ended.

Requests and answers are maps in msgpack. What an agent has done stands in its log in the same form.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from math import inf
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

import msgpack
from pydantic import Field, TypeAdapter, ValidationError

from dcf_zenoh.config import LoadedFleet
from dcf_zenoh.configuration.building.fault_links import fault_of
from dcf_zenoh.configuration.checks.live_faults import refusals
from dcf_zenoh.diagnostics import listed
from dcf_zenoh.errors import ConfigurationError, MessageError
from dcf_zenoh.faults.chain import FaultChain
from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.writer import Recorder
from dcf_zenoh.spec import AgentId, Switch, Table

LONGEST_REQUEST = 1 << 16  # bytes
LONGEST_ANSWER = 1 << 24
EVENT = "fault"  # in the log

T = TypeVar("T")
Senders = Annotated[tuple[AgentId, ...], Field(min_length=1)]


class Change(Table):
    """Let a fault act on what comes from `senders`, from now on, whatever was said before of this name."""

    do: Literal["set"] = "set"
    senders: Senders
    name: Annotated[str, Field(min_length=1, max_length=64)]
    fault: Switch


class Clear(Table):
    """End all that was changed on the links from `senders`."""

    do: Literal["clear"] = "clear"
    senders: Senders


class Show(Table):
    """Tell what was changed so far."""

    do: Literal["show"] = "show"


class Land(Table):
    """End the flight."""

    do: Literal["land"] = "land"


class Halt(Table):
    """Motors off at once. It is for the body, wherever the loop is; the loop ends and answers."""

    do: Literal["stop"] = "stop"


class Done(Table):
    """What an agent has done.

    Attributes:
        time: Since when, fleet time in ns.
        change: What it was asked for.
    """

    time: Annotated[int, Field(ge=0)]
    change: Annotated[Change | Clear, Field(discriminator="do")]


class Answer(Table):
    """What an agent answers.

    Attributes:
        agent: Id.
        time: Fleet time, ns.
        error: Why it has not done what it was asked for; empty if it has.
        senders: Whose links to this agent have changed.
        changes: All that was changed so far, if that was the question.
    """

    agent: AgentId
    time: Annotated[int, Field(ge=0)] = 0
    error: str = ""
    senders: tuple[AgentId, ...] = ()
    changes: tuple[Done, ...] = ()


Order: TypeAlias = Change | Clear | Show | Land | Halt
_REQUEST: TypeAdapter[Order] = TypeAdapter(Annotated[Order, Field(discriminator="do")])
_ANSWER = TypeAdapter(Answer)
_DONE = TypeAdapter(Done)


def _plain(item: Table) -> dict[str, Any]:
    return item.model_dump(exclude_none=True, mode="json")


def encode(item: Table) -> bytes:
    """A request or an answer as bytes."""
    data: bytes = msgpack.packb(_plain(item))
    return data


HALT = encode(Halt())


def decode_request(data: bytes) -> Order:
    """What an operator asks for.

    Raises:
        MessageError: The bytes are not a request.
    """
    return _decode(data, _REQUEST, LONGEST_REQUEST, "a request")


def decode_answer(data: bytes, agent: int) -> Answer:
    """What `agent` answers; one that takes no orders says so without a word.

    Raises:
        MessageError: The bytes are not an answer.
    """
    if not data:
        return Answer(agent=agent, error="takes no orders now: it has not started yet, or its run is over")
    return _decode(data, _ANSWER, LONGEST_ANSWER, "an answer")


def changes_in(log: AgentLog) -> tuple[Done, ...]:
    """What was changed according to the log of an agent, in the order of time.

    Raises:
        MessageError: The log says what nobody can have asked for.
    """
    found = [each for each in log.events if each["event"] == EVENT]
    return tuple(
        _check({"time": each["time"], "change": each.get("change")}, _DONE, "a change of faults") for each in found
    )


class Control:
    """Changes the faults on the links to one agent.

    Args:
        agent: Id.
        fleet: Its fleet.
        neighbours: Whom it hears.
        links: Neighbour -> faults of the link from it, as the agent uses them; links without any are added.
        recorder: Its log.
        end: Ends the flight, for a reason.
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
        self._done: list[Done] = []

    def obey(self, data: bytes, now: int) -> bytes:
        """Do what an operator asks for, or nothing of it.

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
                return encode(Answer(agent=self._agent, time=now, changes=tuple(self._done)))
            if isinstance(request, Land | Halt):
                self._end("landed by an operator" if isinstance(request, Land) else "emergency stop by an operator")
                return encode(Answer(agent=self._agent, time=now))
            self._do(done := Done(time=now, change=request))
        except (MessageError, ConfigurationError) as error:
            return encode(Answer(agent=self._agent, time=now, error=str(error)))
        self._recorder.event(EVENT, now, change=_plain(done.change))
        return encode(Answer(agent=self._agent, time=now, senders=request.senders))

    def restore(self, changes: Iterable[Done]) -> None:
        """Do again what was done in an earlier life of this agent.

        Raises:
            ConfigurationError: It is no longer possible.
        """
        for done in changes:
            self._do(done)

    def _do(self, done: Done) -> None:
        what = done.change
        if strangers := sorted(set(what.senders) - set(self._neighbours)):
            raise MessageError(
                f"agent {self._agent} does not hear {listed(strangers)}; it hears {listed(self._neighbours)}"
            )
        if isinstance(what, Clear):
            for j in what.senders:
                if j in self._links:
                    self._links[j].clear(done.time)
        else:
            spec, folder, name = self._fleet.spec, self._fleet.folder, what.name
            if problems := refusals(spec, folder, name, what.fault):
                raise ConfigurationError(problems)
            faults = {j: fault_of(name, what.fault, j, self._agent, folder) for j in what.senders}
            for j, fault in faults.items():
                link = self._links.setdefault(j, FaultChain(spec.seed, j, self._agent))
                link.add(name, (done.time, inf), fault)
        self._done.append(done)


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
    try:  # strict JSON knows neither bytes nor numbers in strings
        return adapter.validate_json(json.dumps(found, allow_nan=False), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(map(str, first["loc"])) or "do"
        raise MessageError(f"not {what}: {place}: {first['msg']}") from error
    except (TypeError, ValueError, RecursionError) as error:
        raise MessageError(f"not {what}: {error}") from error
