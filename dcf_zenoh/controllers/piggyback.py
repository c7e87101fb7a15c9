"""Tables that ride on every message of an agent, so that what it says arrives although messages are lost."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Inbox, PerNeighbour
from dcf_zenoh.controllers.padding import stacked
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.message import Payload, Value
from dcf_zenoh.plant import Array

PREFIX = "riding."  # of the names of all entries that are added to payloads
ALONE = f"{PREFIX}alone"  # marks a message that carries nothing but tables
MERGED_MAX = 100  # tables that are remembered; in a step each agent tells only a few different ones
Key = tuple[int, ...]
T = TypeVar("T")


class Entry(NamedTuple):
    """A value, and the control step that it is of."""

    step: int
    value: Array


class PiggybackTable:
    """The newest value of each key that has been heard from anybody. Keys are tuples of ids, all of one length.

    Args:
        name: Of its entries in a payload.

    Attributes:
        names: Of its entries in a payload: an index, whose rows are the keys and after each its step, and the values.
        rows: Key -> the newest entry known. One that is shorter than others may end in NaN; see `unstacked`.
    """

    def __init__(self, name: str) -> None:
        self.names = (f"{PREFIX}{name}.index", f"{PREFIX}{name}.values")
        self.rows: dict[Key, Entry] = {}
        self._payload: dict[str, Value] | None = {}
        self._merged: set[bytes] = set()  # indices in which there is nothing new

    def put(self, key: Key, step: int, value: Array) -> None:
        """Take in the `value` of `key` in control step `step`, unless one of that step or a newer one is known."""
        known = self.rows.get(key)
        if known is None or known.step < step:
            self.rows[key] = Entry(step, value)
            self._payload = None

    @property
    def payload(self) -> Mapping[str, Value]:
        """The table as entries of a payload; there are none while it is empty."""
        if self._payload is None:
            keys = sorted(self.rows)
            index = np.array([(*key, self.rows[key].step) for key in keys])
            values = stacked([self.rows[key].value for key in keys])
            index.setflags(write=False)  # one copy for the messages to all neighbours
            values.setflags(write=False)
            self._payload = dict(zip(self.names, (index, values), strict=True))
        return self._payload

    def merge(self, payload: Payload) -> None:
        """Take in what is newer in the table of another agent."""
        if self.names[0] not in payload:
            return
        index = np.asarray(payload[self.names[0]])
        if (told := index.tobytes()) in self._merged:  # as nearly always: a table rides on every message
            return
        for (*key, step), value in zip(index.tolist(), np.asarray(payload[self.names[1]]), strict=True):
            self.put(tuple(key), step, value)
        if len(self._merged) == MERGED_MAX:
            self._merged.clear()
        self._merged.add(told)


class Piggyback:
    """Lets tables ride on the messages of a dialogue that knows nothing of them.

    Args:
        tables: What rides.
    """

    def __init__(self, *tables: PiggybackTable) -> None:
        self._tables = tables
        self._names = frozenset([ALONE, *(name for table in tables for name in table.names)])
        self._allowed: frozenset[str] = frozenset()  # names of the last payload

    def alone(self) -> Dialogue[bool]:
        """One round of nothing but tables; whether there is time left after it."""
        inbox = yield self._loaded({ALONE: 1}), math.inf
        self._hear(inbox)
        return not inbox.stop

    def carry(self, dialogue: Dialogue[T]) -> Dialogue[T]:
        """Lead `dialogue`, adding the tables to what it says, and taking them off what it hears.

        Neighbours that have sent nothing but tables so far are missing to it.

        Raises:
            AlgorithmError: The dialogue uses a name that begins with `PREFIX`.
        """
        try:
            said = next(dialogue)
            while True:
                inbox = yield self._with_tables(said)
                self._hear(inbox)
                said = dialogue.send(self._without_tables(inbox, said[0]))
        except StopIteration as finished:
            result: T = finished.value
            return result

    def _hear(self, inbox: Inbox) -> None:
        for j, payload in inbox.items():
            if inbox.new(j):
                for table in self._tables:
                    table.merge(payload)

    def _with_tables(self, said: Any) -> Any:
        """What goes out in place of what the dialogue said; the exchange refuses what breaks the contract."""
        match said:
            case (PerNeighbour(payloads), residual):
                return PerNeighbour({j: self._loaded(payload) for j, payload in payloads.items()}), residual
            case (Mapping() as payload, residual):
                return self._loaded(payload), residual
        return said

    def _loaded(self, payload: Payload) -> Payload:
        loaded = dict(payload)
        if loaded.keys() != self._allowed:
            for name in loaded:
                if str(name).startswith(PREFIX) and name != ALONE:
                    raise AlgorithmError(f"payload names that begin with {PREFIX!r} are taken: {sorted(loaded)}")
            self._allowed = frozenset(loaded)
        for table in self._tables:
            loaded.update(table.payload)
        return loaded

    def _without_tables(self, inbox: Inbox, payload: Payload | PerNeighbour) -> Inbox:
        """What the dialogue hears, if `payload` is what it said."""
        own: Any = inbox.own
        own = {j: self._bare(own[j]) for j in own} if isinstance(payload, PerNeighbour) else self._bare(own)
        return inbox.replaced(own, {j: self._bare(each) for j, each in inbox.items() if ALONE not in each})

    def _bare(self, payload: Payload) -> Payload:
        names = self._names
        return {name: value for name, value in payload.items() if name not in names}
