"""States of all agents at the beginning of a control step, estimated from what a lossy network delivers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me
from dcf_zenoh.controllers.padding import unstacked
from dcf_zenoh.controllers.piggyback import Piggyback, PiggybackTable
from dcf_zenoh.plant import Array

ROUNDS_PER_HOP = 3  # rounds to wait for the states of a step, per hop and for one hop more
Signs = Mapping[tuple[int, int], Array]


@runtime_checkable
class HasSigns(Protocol):
    """Problem in which the two agents of a pair must make the same choice before they solve it; see `SignedProblem`."""

    def signs(self, states: Mapping[int, Array]) -> Signs:
        """Return the choice that `states` imply for each pair i < j of this agent and another.

        Only pairs of which both states are given have one. Choices are arrays of one shape (n,); the problem defines
        their meaning.
        """


@dataclass(frozen=True)
class FleetView:
    """States and choices that an agent uses in one control step.

    Attributes:
        states: Agent -> [position, velocity], shape (2 d,), of all agents, at the beginning of the step.
        lost: Agents whose newest state is too old; their states are their last positions, at rest.
        predicted: Number of states predicted from those of an earlier step.
        signs: Pair i < j -> choice, of the pairs that this agent is in, without lost agents. Empty if the problem
            has none.
    """

    states: Mapping[int, Array]
    lost: tuple[int, ...]
    predicted: int
    signs: Signs


class FleetStates:
    """Estimates the states of all agents, from tables that piggyback on every message of every round.

    A step begins with rounds of nothing but tables, until all states of the step are there or `ROUNDS_PER_HOP` is used
    up: states predicted at constant velocity change signs at other instants than measured ones do, which makes the
    motion worse. If an agent has both states of a pair for this step, it takes the choice that they imply; the other
    end does the same. If a state is missing, it takes the choice that the lower id made for this step in the step
    before, which had all rounds of that step to spread. That choice follows from states as they were then, not as
    predicted for now: signs that change after the coordinate has are safe, signs that change before it give up the
    barrier that was kept.

    Args:
        me: This agent.
        problem: Problem to solve; `HasSigns` or not.
        sample_time: t_s, in s.
        lost_after: An agent is lost when its newest state is older than this, in s.

    Attributes:
        piggyback: Adds the tables to the messages of a dialogue.
    """

    def __init__(self, me: Me, problem: object, sample_time: float, lost_after: float) -> None:
        self._me = me
        self._problem = problem if isinstance(problem, HasSigns) else None
        self._sample_time = sample_time
        self._age_max = int(lost_after / sample_time + 1e-9)  # steps
        self._states = PiggybackTable("states")  # (agent,) -> its state at that step
        self._signs = PiggybackTable("signs")  # pair -> its signs in that step and in the next, shape (2, n)
        self.piggyback = Piggyback(self._states, self._signs)

    @property
    def unknown(self) -> list[int]:
        """Agents of which no state was ever received."""
        return [i for i in self._me.agents if (i,) not in self._states.rows]

    def share(self, own: Array, step: int) -> Dialogue[FleetView | None]:
        """Exchange states for at least as many rounds as the graph's diameter.

        It continues for up to `ROUNDS_PER_HOP` per hop while states of this step are missing, and without limit while
        an agent is unknown.

        Args:
            own: State of this agent, shape (2 d,).
            step: Number of the control step.

        Returns:
            States and choices to use; None if the step has no time left to use them.
        """
        self._states.put((self._me.id,), step, own)
        rounds, diameter = 0, self._me.neighbourhood.diameter
        while rounds < diameter or self.unknown or (rounds < ROUNDS_PER_HOP * (diameter + 1) and self._outdated(step)):
            if not (yield from self.piggyback.tables_only()):
                return None
            rounds += 1
        ages = {i: step - self._states.rows[(i,)].step for i in self._me.agents}
        lost = tuple(i for i, age in ages.items() if age > self._age_max)
        states = {i: self._predicted(i, step) for i in ages}
        signs = self._signs_in(step, lost)
        for pair, following in self._implied(step, lost).items():
            if pair[0] == self._me.id:
                self._signs.put(pair, step, np.array([signs[pair], following]))
        return FleetView(states, lost, sum(0 < age <= self._age_max for age in ages.values()), signs)

    def disagreements(self, view: FleetView, step: int) -> int:
        """Return in how many pairs the lower id is known to have used other signs in `step` than those of `view`."""
        count = 0
        for pair, used in view.signs.items():
            known = self._signs.rows.get(pair)
            count += known is not None and known.step == step and not np.array_equal(known.value[0], used)
        return count

    def _signs_in(self, step: int, lost: tuple[int, ...]) -> dict[tuple[int, int], Array]:
        """Return the signs of this agent's pairs in `step`.

        They follow from measured states if there are both, else from the newest known choice, else from predicted
        states.
        """
        signs = self._implied(step, lost)
        for pair in signs:
            known = self._signs.rows.get(pair)
            measured = all(self._states.rows[(i,)].step == step for i in pair)
            if not measured and known is not None and step - known.step <= self._age_max:
                signs[pair] = known.value[0 if known.step == step else 1]
        return signs

    def _outdated(self, step: int) -> bool:
        """Return whether the state of an agent that is not lost is of an earlier step than `step`."""
        return any(0 < step - state.step <= self._age_max for state in self._states.rows.values())

    def _implied(self, step: int, lost: tuple[int, ...]) -> dict[tuple[int, int], Array]:
        """Return the signs that the states at `step` imply."""
        if self._problem is None:
            return {}
        return dict(self._problem.signs({i: self._predicted(i, step) for i in self._me.agents if i not in lost}))

    def _predicted(self, agent: int, step: int) -> Array:
        """Return the state of a known agent at `step`, at constant velocity since the newest entry; at rest if lost."""
        then, state = self._states.rows[(agent,)]
        position, velocity = np.split(unstacked(state), 2)
        if step - then > self._age_max:
            return np.concatenate((position, np.zeros_like(velocity)))
        return np.concatenate((position + velocity * ((step - then) * self._sample_time), velocity))
