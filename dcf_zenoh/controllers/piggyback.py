"""Tables that piggyback on every message of an agent, so that their entries get through although messages are lost."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Inbox, PerNeighbour
from dcf_zenoh.controllers.padding import stacked
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.message import Payload, Value
from dcf_zenoh.plant import Array

# Both names are on the wire: their lengths count in a message's size, on which faults of bandwidth act.
PREFIX = "riding."  # prefix of the payload entries that hold tables
TABLES_ONLY = f"{PREFIX}alone"  # name of the entry that marks a payload without entries of a dialogue
MERGED_MAX = 100  # tables remembered as merged; within a step each agent sends only a few different ones
Key = tuple[int, ...]
T = TypeVar("T")


class Entry(NamedTuple):
    """Value of one key of a table.

    Attributes:
        step: Control step that the value belongs to.
        value: Value, shape (n,).
    """

    step: int
    value: Array


class PiggybackTable:
    """Newest known value of each key, own or received. Keys are tuples of ids, all of one length.

    Args:
        name: Name of the table in payloads.

    Attributes:
        names: Names of the table's two payload entries: the index, whose rows are key and step, and the values.
        rows: Key -> newest entry. A value that is shorter than others may be padded with NaN; see `unstacked`.
    """

    def __init__(self, name: str) -> None:
        self.names = (f"{PREFIX}{name}.index", f"{PREFIX}{name}.values")
        self.rows: dict[Key, Entry] = {}
        self._payload: dict[str, Value] | None = {}
        self._merged: set[bytes] = set()  # indices that hold nothing new

    def put(self, key: Key, step: int, value: Array) -> None:
        """Enter the `value` of `key` in control step `step`, unless the table has one of that step or a newer one."""
        known = self.rows.get(key)
        if known is None or known.step < step:
            self.rows[key] = Entry(step, value)
            self._payload = None

    @property
    def payload(self) -> Mapping[str, Value]:
        """The table as payload entries; none while it is empty."""
        if self._payload is None:
            keys = sorted(self.rows)
            index = np.array([(*key, self.rows[key].step) for key in keys])
            values = stacked([self.rows[key].value for key in keys])
            index.setflags(write=False)  # one copy for the messages to all neighbours
            values.setflags(write=False)
            self._payload = dict(zip(self.names, (index, values), strict=True))
        return self._payload

    def merge(self, payload: Payload) -> None:
        """Enter what is newer in another agent's table, as received in `payload`."""
        if self.names[0] not in payload:
            return
        index = np.asarray(payload[self.names[0]])
        if (received := index.tobytes()) in self._merged:  # the usual case: every message carries the table
            return
        for (*key, step), value in zip(index.tolist(), np.asarray(payload[self.names[1]]), strict=True):
            self.put(tuple(key), step, value)
        if len(self._merged) == MERGED_MAX:
            self._merged.clear()
        self._merged.add(received)


class Piggyback:
    """Adds tables to the payloads of a dialogue and removes them from its inboxes; the dialogue is unaware of them.

    Args:
        tables: Tables to send with every message.
    """

    def __init__(self, *tables: PiggybackTable) -> None:
        self._tables = tables
        self._names = frozenset([TABLES_ONLY, *(name for table in tables for name in table.names)])
        self._allowed: frozenset[str] = frozenset()  # names of the last payload

    def tables_only(self) -> Dialogue[bool]:
        """Exchange one round of nothing but tables, and return whether the step has time left after it."""
        inbox = yield self._loaded({TABLES_ONLY: 1}), math.inf
        self._merge(inbox)
        return not inbox.stop

    def wrap(self, dialogue: Dialogue[T]) -> Dialogue[T]:
        """Run `dialogue` with the tables added to its payloads and removed from its inboxes.

        A neighbour that has sent nothing but tables so far is missing in the dialogue's inbox.

        Raises:
            AlgorithmError: The dialogue uses a name that begins with `PREFIX`.
        """
        try:
            yielded = next(dialogue)
            while True:
                inbox = yield self._with_tables(yielded)
                self._merge(inbox)
                yielded = dialogue.send(self._without_tables(inbox, yielded[0]))
        except StopIteration as finished:
            result: T = finished.value
            return result

    def _merge(self, inbox: Inbox) -> None:
        for j, payload in inbox.items():
            if inbox.new(j):
                for table in self._tables:
                    table.merge(payload)

    def _with_tables(self, yielded: Any) -> Any:
        """Return what the dialogue yielded, with tables. The exchange refuses what breaks the contract."""
        match yielded:
            case (PerNeighbour(payloads), residual):
                return PerNeighbour({j: self._loaded(payload) for j, payload in payloads.items()}), residual
            case (Mapping() as payload, residual):
                return self._loaded(payload), residual
        return yielded

    def _loaded(self, payload: Payload) -> Payload:
        loaded = dict(payload)
        if loaded.keys() != self._allowed:
            for name in loaded:
                if str(name).startswith(PREFIX) and name != TABLES_ONLY:
                    raise AlgorithmError(f"payload names that begin with {PREFIX!r} are taken: {sorted(loaded)}")
            self._allowed = frozenset(loaded)
        for table in self._tables:
            loaded.update(table.payload)
        return loaded

    def _without_tables(self, inbox: Inbox, payload: Payload | PerNeighbour) -> Inbox:
        """Return the inbox of a dialogue that yielded `payload`."""
        own: Any = inbox.own
        own = {j: self._bare(own[j]) for j in own} if isinstance(payload, PerNeighbour) else self._bare(own)
        return inbox.replaced(own, {j: self._bare(each) for j, each in inbox.items() if TABLES_ONLY not in each})

    def _bare(self, payload: Payload) -> Payload:
        names = self._names
        return {name: value for name, value in payload.items() if name not in names}
