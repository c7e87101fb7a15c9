"""The safety supervisor: it stands between an agent's decisions and its body, whatever the body and the method are."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from dcf_zenoh.plant import Array, Setpoint, State
from dcf_zenoh.spec import Arena, LimitRule, Safety

# What may follow from an alarm, the most severe last.
REACTIONS = ("log", "clip", "hold", "land", "stop")


class Alarm(NamedTuple):
    """Something that must not happen has happened.

    Attributes:
        rule: Key of ``[safety]``.
        then: What follows; one of `REACTIONS`.
        text: What has happened, with numbers and units.
    """

    rule: str
    then: str
    text: str


class Supervisor:
    """Watches one agent.

    An alarm is new when the same rule gave none at the last look; only new ones are worth a line in the log.

    Args:
        rules: Of the fleet file.
        arena: Where the agent may be; None: anywhere.
        sample_time: t_s, s.
    """

    def __init__(self, rules: Safety, arena: Arena | None, sample_time: float) -> None:
        self._rules = rules
        self._arena = arena
        self._sample_time = sample_time
        self._late = 0
        self._sounding: dict[str, set[str]] = {}  # look -> rules that gave alarm then

    def body(self, state: State) -> list[Alarm]:
        """Look at where the body is, and how fast."""
        alarms = []
        if self._arena and (where := _outside(state.position, self._arena)):
            alarms.append(Alarm("geofence", self._rules.geofence, f"outside the arena: {where}"))
        if (limit := self._rules.speed) and limit.then != "clip":
            speed = float(np.linalg.norm(state.velocity))
            if speed > limit.max:
                text = f"flies at {speed:.2f} m/s, at most {limit.max:g} m/s is allowed"
                alarms.append(Alarm("speed", limit.then, text))
        return alarms

    def separation(self, state: State, neighbours: Mapping[int, Sequence[float]]) -> list[Alarm]:
        """Look at how near the neighbours are: id -> position, m, of those who have told."""
        rule = self._rules.separation
        if rule is None:
            return []
        alarms = []
        for j in sorted(neighbours):
            size = min(len(state.position), len(neighbours[j]))
            gap = float(np.linalg.norm(state.position[:size] - np.array(neighbours[j][:size])))
            if gap < rule.min:
                text = f"{gap:.3f} m from agent {j}, at least {rule.min:g} m is wanted"
                alarms.append(Alarm("separation", rule.then, text))
        return alarms

    def setpoint(self, setpoint: Setpoint, state: State) -> tuple[Setpoint, list[Alarm]]:
        """The setpoint within its limits, where these say clip, and what there is to say of it."""
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
        """Count a step that overran, or one that did not."""
        self._late = self._late + 1 if late else 0
        rule = self._rules.missed_deadlines
        if rule is None or self._late < rule.in_a_row:
            return []
        return [Alarm("missed_deadlines", rule.then, f"{self._late} steps in a row were late")]

    def neighbours(self, lost: Sequence[str]) -> list[Alarm]:
        """What follows from the loss of neighbours, each told in words."""
        then = self._rules.neighbour_silent.then
        return [Alarm("neighbour_silent", "log" if then == "continue" else then, "; ".join(lost))] if lost else []

    def not_finite(self, text: str) -> list[Alarm]:
        """What follows from a decision or setpoint that is not finite."""
        return [Alarm("not_finite", self._rules.not_finite, text)]

    def fresh(self, look: str, alarms: Sequence[Alarm]) -> list[Alarm]:
        """Those of `alarms` that were not there at the last `look` of this name."""
        before, self._sounding[look] = self._sounding.get(look, set()), {alarm.rule for alarm in alarms}
        return [alarm for alarm in alarms if alarm.rule not in before]


def most_severe(alarms: Sequence[Alarm]) -> Alarm | None:
    """Return the alarm with the most severe reaction, the first of several; None if there is no alarm."""
    return max(alarms, key=lambda alarm: REACTIONS.index(alarm.then), default=None)


def _outside(position: Array, arena: Arena) -> str:
    """Which coordinates are outside, in words; empty if none is."""
    return ", ".join(
        f"{axis} = {value:.2f} m, allowed {low:g} .. {high:g} m"
        for axis, value, low, high in zip("xyz", position, arena.min, arena.max, strict=False)
        if not low <= value <= high
    )


def _limited(name: str, unit: str, rule: LimitRule, vector: Array, alarms: list[Alarm]) -> Array:
    """The vector itself if it is within the limit, or nothing shall be clipped; else one that is."""
    magnitude = float(np.linalg.norm(vector))
    if not magnitude > rule.max * (1 + 1e-12):
        return vector
    text = f"commanded {name} is {magnitude:.2f} {unit}, at most {rule.max:g} {unit} is allowed"
    alarms.append(Alarm(name, rule.then, text))
    return _clip(vector, rule.max) if rule.then == "clip" else vector


def _clip(vector: Array, limit: float) -> Array:
    """The vector, shortened to the limit where it is longer."""
    magnitude = float(np.linalg.norm(vector))
    return vector * (limit / magnitude) if magnitude > limit else vector
