"""Safety supervisor: checks between an agent's decisions and its body, for any plant and algorithm."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from dcf_zenoh.diagnostics import reason
from dcf_zenoh.plant import Array, Setpoint, State
from dcf_zenoh.rounds.receiver import KnownPosition
from dcf_zenoh.spec import Arena, LimitRule, Safety

# What may follow from an alarm, the most severe last.
REACTIONS = ("log", "clip", "hold", "land", "stop")


class Alarm(NamedTuple):
    """Violation of a safety rule.

    Attributes:
        rule: Key of the rule in ``[safety]``.
        then: Reaction; one of `REACTIONS`.
        text: Description, with numbers and units.
    """

    rule: str
    then: str
    text: str


class Supervisor:
    """Supervisor of one agent.

    An alarm is new when the same rule gave none at the last check of the same name; only new alarms are logged.

    Args:
        rules: Table ``[safety]`` of the fleet file.
        arena: Bounds of the position; None: none.
        sample_time: t_s, s.
        barrier: Own position and that of a neighbour, shape (d,), m -> barrier value h of the problem's safety region;
            None: it has none.
    """

    def __init__(
        self,
        rules: Safety,
        arena: Arena | None,
        sample_time: float,
        barrier: Callable[[Array, Array], Array] | None = None,
    ) -> None:
        self._rules = rules
        self._barrier = barrier
        self._arena = arena
        self._sample_time = sample_time
        self._late = 0
        self._sounding: dict[str, set[str]] = {}  # check -> rules that gave an alarm at the last one

    def body(self, state: State) -> list[Alarm]:
        """Check the position and the speed of the body."""
        alarms = []
        if self._arena and (where := _outside(state.position, self._arena)):
            alarms.append(Alarm("geofence", self._rules.geofence, f"outside the arena: {where}"))
        if (limit := self._rules.speed) and limit.then != "clip":
            speed = float(np.linalg.norm(state.velocity))
            if speed > limit.max:
                text = f"flies at {speed:.2f} m/s, at most {limit.max:g} m/s is allowed"
                alarms.append(Alarm("speed", limit.then, text))
        return alarms

    def separation(self, state: State, neighbours: Mapping[int, KnownPosition], step: int) -> list[Alarm]:
        """Check in `step` the separation from the neighbours whose positions are known."""
        rule = self._rules.separation
        if rule.then == "ignore" or (rule.min is None and self._barrier is None):
            return []
        alarms = []
        for j, known in sorted(neighbours.items()):
            size = min(len(state.position), len(known.position))
            name = f"agent {j}" if known.step == step else f"agent {j} as of step {known.step}"
            if size and (text := self._too_near(state.position[:size], np.array(known.position[:size]), name)):
                alarms.append(Alarm("separation", rule.then, text))
        return alarms

    def _too_near(self, own: Array, other: Array, name: str) -> str:
        """Describe two positions that are too near, the other one of the agent `name`; empty if they are not."""
        least = self._rules.separation.min
        if least is not None:
            gap = float(np.linalg.norm(own - other))
            return "" if gap >= least else f"{gap:.3f} m from {name}, at least {least:g} m is wanted"
        assert self._barrier is not None
        try:
            value = float(self._barrier(own, other))
        except Exception as error:  # the code of a third party must not end a flight
            return f"the safety region with {name} cannot be computed: {reason(error)}"
        return "" if value >= 0 else f"in the safety region with {name}: h = {value:.3f}"

    def setpoint(self, setpoint: Setpoint, state: State) -> tuple[Setpoint, list[Alarm]]:
        """Return the setpoint, clipped where the rules say so, and the alarms on it."""
        alarms: list[Alarm] = []
        if setpoint.acceleration is None:
            return setpoint, alarms
        velocity, acceleration = setpoint.velocity, setpoint.acceleration
        if rule := self._rules.acceleration:
            acceleration = _limited("acceleration", "m/s²", rule, acceleration, alarms)
        if rule := self._rules.speed:
            now = state.velocity[: len(acceleration)]
            after = now + acceleration * self._sample_time
            within = _limited("speed", "m/s", rule, after, alarms)
            velocity = _clip(velocity, rule.max) if rule.then == "clip" else velocity
            if within is not after:
                acceleration = (within - now) / self._sample_time
        return Setpoint(setpoint.position, velocity, acceleration), alarms

    def deadline(self, *, late: bool) -> list[Alarm]:
        """Check how many steps in a row overran, this one included."""
        self._late = self._late + 1 if late else 0
        rule = self._rules.missed_deadlines
        if rule is None or self._late < rule.in_a_row:
            return []
        return [Alarm("missed_deadlines", rule.then, f"{self._late} steps in a row were late")]

    def payloads(self, misshapen: Mapping[int, str]) -> list[Alarm]:
        """Return the alarms on neighbours whose payloads were taken for missing: id -> what was wrong."""
        return [
            Alarm("misshapen", "log", f"a payload of agent {j} was taken for missing: {text}")
            for j, text in sorted(misshapen.items())
        ]

    def neighbours(self, lost: Sequence[str]) -> list[Alarm]:
        """Return the alarm on lost neighbours, each described in words."""
        then = self._rules.neighbour_silent.then
        return [Alarm("neighbour_silent", "log" if then == "continue" else then, "; ".join(lost))] if lost else []

    def not_finite(self, text: str) -> list[Alarm]:
        """Return the alarm on a decision or setpoint that is not finite."""
        return [Alarm("not_finite", self._rules.not_finite, text)]

    def fresh(self, name: str, alarms: Sequence[Alarm]) -> list[Alarm]:
        """Return the alarms of the check `name` whose rules gave none at its last check."""
        before, self._sounding[name] = self._sounding.get(name, set()), {alarm.rule for alarm in alarms}
        return [alarm for alarm in alarms if alarm.rule not in before]


def most_severe(alarms: Sequence[Alarm]) -> Alarm | None:
    """Return the alarm with the most severe reaction, the first of several; None if there is no alarm."""
    return max(alarms, key=lambda alarm: REACTIONS.index(alarm.then), default=None)


def _outside(position: Array, arena: Arena) -> str:
    """Describe the coordinates outside the arena; empty if none is."""
    return ", ".join(
        f"{axis} = {value:.2f} m, allowed {low:g} .. {high:g} m"
        for axis, value, low, high in zip("xyz", position, arena.min, arena.max, strict=False)
        if not low <= value <= high
    )


def _limited(name: str, unit: str, rule: LimitRule, vector: Array, alarms: list[Alarm]) -> Array:
    """Return the vector, clipped if it exceeds the limit and the rule says so; append an alarm if it exceeds it."""
    magnitude = float(np.linalg.norm(vector))
    if not magnitude > rule.max * (1 + 1e-12):
        return vector
    text = f"commanded {name} is {magnitude:.2f} {unit}, at most {rule.max:g} {unit} is allowed"
    alarms.append(Alarm(name, rule.then, text))
    return _clip(vector, rule.max) if rule.then == "clip" else vector


def _clip(vector: Array, limit: float) -> Array:
    """Return the vector, shortened to the limit if it is longer."""
    magnitude = float(np.linalg.norm(vector))
    return vector * (limit / magnitude) if magnitude > limit else vector
