"""Comparison of two runs: the first difference, and the largest ones."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from dcf_zenoh.records.agent_log import AgentLog
from dcf_zenoh.records.run import Run
from dcf_zenoh.rounds.dialogue import RoundRecord

STEPS = "number of steps"
MESSAGE = "message from"  # followed by the id of the sender


class Deviation(NamedTuple):
    """Difference of one quantity of one agent in one step or round.

    Attributes:
        quantity: 'number of steps', 'state', 'rounds', 'decision', 'setpoint', 'residual', 'message from' an id, or a
            name in the log of a round.
        size: Largest absolute difference of an entry; infinite where one run has a number and the other has none. Of a
            message: difference of the delays, in s; infinite where it was lost, or doubled, in one run only.
        agent: Id of the agent.
        step: Control step k.
        round: Round p; None for a quantity of the step as a whole.
    """

    quantity: str
    size: float
    agent: int
    step: int
    round: int | None = None


@dataclass(frozen=True)
class Comparison:
    """Result of the comparison of two runs.

    Attributes:
        remark: Remark that the fleets are different; empty if they are not.
        comparable: Whether both runs have the same agents. If not, nothing else is compared.
        first: First deviation above the tolerance, by step, then in order of time, then agent; None: there is none.
        largest: Quantity -> largest deviation, of the quantities that deviate at all; largest first.
        tolerance: Largest deviation that does not count.
        sample_time: t_s, s.
    """

    remark: str
    comparable: bool
    first: Deviation | None
    largest: Mapping[str, Deviation]
    tolerance: float
    sample_time: float

    @property
    def identical(self) -> bool:
        """Whether nothing deviates by more than the tolerance."""
        return self.comparable and self.first is None

    def __str__(self) -> str:
        parts = [self.remark] if self.remark else []
        if self.identical:
            parts.append(f"identical within {self.tolerance:g}" if self.largest else "identical")
        elif self.first is not None:
            parts.append(f"agent {self.first.agent} differs first: {self._place(self.first)}")
        if self.largest:
            each = [f"{d.quantity} {_size(d)} (agent {d.agent}, step {d.step})" for d in self.largest.values()]
            parts.append("largest deviations: " + ", ".join(each))
        return "; ".join(parts)

    def _place(self, deviation: Deviation) -> str:
        round = "" if deviation.round is None else f", round {deviation.round}"
        time = deviation.step * self.sample_time
        return f"step {deviation.step} ({time:.6g} s){round}, {deviation.quantity}: {_size(deviation)}"


def compare(a: Run, b: Run, *, tolerance: float = 0.0) -> Comparison:
    """Compare the logs of two runs, without times on the wall clock.

    Of each step, these are compared: the state; if both runs have logged rounds, payload, residual and notes of each;
    the number of rounds, the last residual, the decision and the setpoint. Of two runs in virtual time, also the
    effects of links on the messages of the step: losses and delays. Two NaN are equal.

    Args:
        a: One run.
        b: The other.
        tolerance: Largest deviation that does not count.
    """
    fleets = [f"{run.fleet.name} (agents {_listed(run)})" for run in (a, b)]
    if set(a.agents) != set(b.agents):
        return Comparison(
            f"not comparable: {fleets[0]} and {fleets[1]} have logs of different agents", False, None, {}, tolerance,
            a.fleet.time.sample_time,
        )  # fmt: skip
    if not any(len(log.step) for run in (a, b) for log in run.agents.values()):
        nothing = "not comparable: neither run has recorded a single step"
        return Comparison(nothing, False, None, {}, tolerance, a.fleet.time.sample_time)
    remark = "" if a.fleet.name == b.fleet.name else f"different fleets: {a.fleet.name} and {b.fleet.name}"
    first: Deviation | None = None
    largest: dict[str, Deviation] = {}
    for found in _deviations(a, b):
        if first is None and found.size > tolerance:
            first = found
        if found.quantity not in largest or found.size > largest[found.quantity].size:
            largest[found.quantity] = found
    ordered = sorted(largest.values(), key=lambda each: -each.size)
    return Comparison(
        remark, True, first, {each.quantity: each for each in ordered}, tolerance, a.fleet.time.sample_time
    )


def _deviations(a: Run, b: Run) -> Iterator[Deviation]:
    """Yield all deviations in order of time, because the first one in time is likelier the cause than the lowest id."""
    pairs = {agent: (a.agents[agent], b.agents[agent]) for agent in sorted(a.agents)}
    modelled = a.fleet.time.clock == b.fleet.time.clock == "virtual"
    effects = {agent: tuple(_link_effects(log) if modelled else {} for log in pair) for agent, pair in pairs.items()}
    for row in range(max(len(log.step) for pair in pairs.values() for log in pair)):
        found: list[Deviation] = []
        for agent, (one, other) in pairs.items():
            shorter, longer = sorted((len(one.step), len(other.step)))
            if row < shorter:
                found += _step_deviations(agent, row, one, other)
                found += _message_deviations(agent, int(one.step[row]), *effects[agent])
            elif row == shorter < longer:
                step = int(max(one.step, other.step, key=len)[row])
                found.append(Deviation(STEPS, float(longer - shorter), agent, step))
        yield from sorted(found, key=_moment)


def _moment(deviation: Deviation) -> float:
    """Return a key for the order within a step: the state first, then the rounds, then their results."""
    if deviation.quantity == "state":
        return -1.0
    if deviation.round is not None and deviation.quantity.startswith(MESSAGE):
        return deviation.round + 0.5  # after it was sent
    return math.inf if deviation.round is None else deviation.round


def _step_deviations(agent: int, row: int, one: AgentLog, other: AgentLog) -> Iterator[Deviation]:
    step = int(one.step[row])
    pairs: list[tuple[str, Any, Any, int | None]] = [("state", one.state[row], other.state[row], None)]
    records = zip(one.rounds_log[row], other.rounds_log[row], strict=False)
    for round, (record, record_other) in enumerate(records):
        record_a, record_b = RoundRecord(*record), RoundRecord(*record_other)
        if record_a._replace(received_at={}) != record_b._replace(received_at={}):
            pairs += [(name, *values, round) for name, values in _round_quantities(record_a, record_b)]
    for name in ("rounds", "residual", "decision", "setpoint"):
        pairs.append((name, getattr(one, name)[row], getattr(other, name)[row], None))
    for name, value, value_other, place in pairs:
        size = _difference(value, value_other)
        if size > 0:
            yield Deviation(name, size, agent, step, place)


class _LinkEffect(NamedTuple):
    """Effect of a link on one message, or on a copy of it: delay in ns, or loss."""

    delay: int
    lost: bool


_LinkEffects = dict[
    int, dict[tuple[int, int, int, int], _LinkEffect]
]  # step -> round, sender, sequence, copy -> effect


def _link_effects(log: AgentLog) -> _LinkEffects:
    """Return the effects on messages that were lost, delayed or doubled; all others came at once."""
    found: _LinkEffects = {}
    copies: Counter[tuple[int, int, int]] = Counter()
    for each in log.passed:
        place = (each.sender, each.sequence, each.entered)
        effect = _LinkEffect(0 if each.lost_by else each.due - each.entered, bool(each.lost_by))
        if effect != _AT_ONCE or copies[place]:
            found.setdefault(each.step, {})[each.round, each.sender, each.sequence, copies[place]] = effect
        copies[place] += 1
    return found


_AT_ONCE = _LinkEffect(0, lost=False)


def _message_deviations(agent: int, step: int, one: _LinkEffects, other: _LinkEffects) -> Iterator[Deviation]:
    here, there = one.get(step, {}), other.get(step, {})
    for key in sorted(here.keys() | there.keys()):
        round, sender, _, copy = key
        missing = _LinkEffect(0, lost=True) if copy else _AT_ONCE
        x, y = here.get(key, missing), there.get(key, missing)
        if x != y:
            size = abs(x.delay - y.delay) * 1e-9 if x.lost == y.lost else math.inf
            yield Deviation(f"{MESSAGE} {sender}", size, agent, step, round)


def _round_quantities(one: RoundRecord, other: RoundRecord) -> Iterator[tuple[str, tuple[Any, Any]]]:
    """Yield payload, residual and notes of a round, by name, from both runs; None where one of them has none."""
    yield from _joined(_flat(one.payload), _flat(other.payload))
    yield "residual", (one.residual, other.residual)
    yield from _joined(_flat(one.noted), _flat(other.noted))


def _joined(one: Mapping[str, Any], other: Mapping[str, Any]) -> Iterator[tuple[str, tuple[Any, Any]]]:
    for name in dict.fromkeys([*one, *other]):
        yield name, (one.get(name), other.get(name))


def _flat(values: Mapping[Any, Any]) -> dict[str, Any]:
    """Return values by name; those for single neighbours as ``x to 2``."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        inner = {f"{name} to {key}": each for name, each in value.items()} if isinstance(value, Mapping) else None
        flat |= {str(key): value} if inner is None else inner
    return flat


def _difference(one: Any, other: Any) -> float:
    """Return the largest absolute difference; infinite where sizes differ, or only one is a number."""
    if one is None or other is None:
        return 0.0 if one is other else math.inf
    x, y = _numbers(one), _numbers(other)
    if x.shape != y.shape:
        return math.inf
    differs = ~((x == y) | (np.isnan(x) & np.isnan(y)))
    if not differs.any():
        return 0.0
    apart = np.abs(x[differs] - y[differs])
    return math.inf if np.isnan(apart).any() else float(apart.max())


def _numbers(value: Any) -> npt.NDArray[np.float64]:
    """Return an array of numbers; other values become the bytes of their text, which are equal for equal values."""
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return np.frombuffer(repr(value).encode(), dtype=np.uint8).astype(np.float64)


def _size(deviation: Deviation) -> str:
    if deviation.quantity == STEPS:
        return f"{deviation.size:.0f} more in one run"
    if deviation.quantity.startswith(MESSAGE):
        return "lost or doubled in one run only" if math.isinf(deviation.size) else f"{deviation.size:.2g} s"
    if math.isinf(deviation.size):
        return "a number in one run only"
    return f"{deviation.size:.0f}" if deviation.quantity == "rounds" else f"{deviation.size:.2g}"


def _listed(run: Run) -> str:
    return ", ".join(map(str, sorted(run.agents)))
