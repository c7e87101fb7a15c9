"""Schema of the log of an agent, by which it is checked object by object.

A log is read up to its first invalid object. What follows is left out, even if it is valid: steps missing in the middle
would be taken for steps in which the agent took no part.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from dcf_zenoh.errors import RecordingError
from dcf_zenoh.records.log_writer import SCHEMAS, StepRecord, read_stream
from dcf_zenoh.spec import FleetSpec

OWNER = ("agent", "fleet", "seed")  # entries of a header that identify the log

_Integer = Annotated[int, Field(strict=True, ge=-(2**63), lt=2**63)]
_Count = Annotated[int, Field(strict=True, ge=0, lt=2**63)]
_Number = Annotated[float, Field(strict=True)]
_Flag = Annotated[bool, Field(strict=True)]
_Text = Annotated[str, Field(strict=True)]
_Note = Annotated[int, Field(strict=True)] | _Number | _Flag  # kept as it is
_StoppedBy = Literal["agreed", "rounds", "budget", "returned", "abstained"]
_Link = tuple[_Count, _Count, _Count, _Count, _Count]
_Passed = tuple[_Count, _Count, _Count, _Count, _Integer, _Integer, _Text]
_Round = tuple[dict[Any, Any], _Number, dict[_Count, _Integer], dict[_Text, Any]]
_STEP: TypeAdapter[tuple[Any, ...]] = TypeAdapter(
    tuple[
        _Count, _Integer, list[_Number], _Integer, list[_Number], list[_Number], _Count, _Number, _StoppedBy, _Flag,
        _Count, list[_Link], list[_Passed], dict[_Text, _Note], list[_Round], _Text,
    ]
)  # fmt: skip


class _Header(BaseModel):
    agent: _Count
    fleet: _Text = ""
    seed: _Integer = 0
    run: _Text = ""
    clock_offsets: dict[_Count, tuple[_Number, _Number]] = {}


class _Event(BaseModel):
    event: _Text
    time: _Integer


class _Alarm(_Event):
    rule: _Text


class _End(BaseModel):
    end: _Text
    time: _Integer
    state: list[_Number]
    remark: _Text
    counts: dict[_Text, _Count]
    unmet: list[tuple[_Count, _Text, _Text]]


@dataclass
class Records:
    """The objects of one log, in the order of time.

    Attributes:
        header: The first object.
        lives: Number of headers.
        steps: Control steps, ascending.
        events: Events between the steps.
        end: End of the last life; None if the log was cut off in it, or is damaged.
        earlier: Last step and end of each earlier life; no end of one that broke off.
        damage: Place and kind of the damage; empty if there is none.
    """

    header: dict[Any, Any] = field(default_factory=dict)
    lives: int = 0
    steps: list[StepRecord] = field(default_factory=list)
    events: list[dict[Any, Any]] = field(default_factory=list)
    end: dict[Any, Any] | None = None
    earlier: list[tuple[int, dict[Any, Any] | None]] = field(default_factory=list)
    damage: str = ""
    _begun: bool = False  # whether there is a step since the last header

    @classmethod
    def read(cls, data: bytes, fleet: FleetSpec | None = None) -> "Records":
        """Read a stream up to where it was cut off, or to its first invalid object.

        Zeros at the end of the file, which a file system can leave after a loss of power, are no damage.

        Args:
            data: The stream.
            fleet: Fleet that has the agents and steps in the log; None: any.

        Raises:
            RecordingError: It does not begin with a header that this version can read.
        """
        found, end = cls(), 0
        try:
            for item, after in read_stream(data):
                found._take(item, fleet)
                end = after
        except ValueError as error:
            what = _first_of(error) if isinstance(error, ValidationError) else str(error)
            if not found.lives:
                raise RecordingError(f"not a log of an agent: its header cannot be read: {what}") from error
            if data[end:].strip(b"\0"):
                found.end = None
                found.damage = f"damaged {found._last} (byte {end} of {len(data)}): {what}"
        if not found.lives:
            raise RecordingError("not a log of an agent: it has no header")
        return found

    @property
    def _last(self) -> str:
        return f"after step {self.steps[-1].step}" if self.steps else "before its first step"

    def _take(self, item: object, fleet: FleetSpec | None) -> None:
        """Check and keep the next object.

        Raises:
            ValueError: It is not valid here.
            RecordingError: It is the first one, and no header of this version.
        """
        if not self.lives and not (isinstance(item, dict) and "schema" in item):
            raise RecordingError("not a log of an agent: it has no header")
        if isinstance(item, list):
            self.steps.append(self._step(item, fleet))
            self._begun = True
        elif not isinstance(item, dict):
            raise ValueError(f"expected a list or a map, not {type(item).__name__}")
        elif "schema" in item:
            self._take_header(item)
        elif "event" in item:
            (_Alarm if item["event"] == "alarm" else _Event).model_validate(item)
            self.events.append(item)
        else:
            _End.model_validate(item)
            self.end = item

    def _take_header(self, header: dict[Any, Any]) -> None:
        if header["schema"] not in SCHEMAS:
            if self.lives:
                raise ValueError(f"a header of schema {header['schema']!r:.20}")
            read = " and ".join(map(str, SCHEMAS))
            raise RecordingError(f"log schema {header['schema']!r:.20}; this version reads {read}")
        _Header.model_validate(header)
        if self.lives and any(header.get(name) != self.header.get(name) for name in OWNER):
            raise ValueError(f"a header of {owner_of(header)} in the log of {owner_of(self.header)}")
        self.header = self.header or header
        if self.lives:
            self.earlier.append((self.steps[-1].step if self.steps else -1, self.end))
        self.lives += 1
        self._begun = False
        self.end = None  # that of an earlier life

    def _step(self, item: list[Any], fleet: FleetSpec | None) -> StepRecord:
        """Return a checked control step: the next one, or after a header any later one."""
        record = StepRecord._make(_STEP.validate_python(item))
        before = self.steps[-1].step if self.steps else -1
        if record.step <= before or (self._begun and record.step != before + 1):
            raise ValueError(f"step {record.step} instead of {before + 1}")
        if record.acted < record.sensed:
            raise ValueError("acted before sensing")
        senders = {link[0] for link in record.links}
        if any(passed[0] not in senders or (passed[5] < passed[4] and not passed[6]) for passed in record.passed):
            raise ValueError("passed: a message of nobody that is heard, or one that came before it was sent")
        if fleet is not None:
            _check_known(record, senders, fleet)
        return record


def owner_of(header: Mapping[str, Any]) -> str:
    """Return agent, fleet and seed of a header, as text."""
    return ", ".join(f"{name} {header.get(name)!r:.80}" for name in OWNER)


def _check_known(record: StepRecord, senders: set[int], fleet: FleetSpec) -> None:
    """Check that the fleet has the steps and agents of a record.

    Raises:
        ValueError: It does not.
    """
    if unknown := senders - fleet.agents.keys():
        raise ValueError(f"links: there is no agent {min(unknown)}")
    latest = max(record.step, max((passed[2] for passed in record.passed), default=0))
    if latest >= fleet.steps:
        raise ValueError(f"step {latest} of {fleet.steps}")


def _first_of(error: ValidationError) -> str:
    """Return the first problem, in one line."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    top, *below = first["loc"]
    name = StepRecord._fields[top] if isinstance(top, int) and top < len(StepRecord._fields) else top
    place = (str(part) for part in (name, *below) if isinstance(part, int) or part.isidentifier())
    return f"{'.'.join(place)}: {first['msg']}"
