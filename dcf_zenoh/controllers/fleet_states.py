"""What an agent knows of the others at the beginning of a control step, from what they say over a lossy network."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me
from dcf_zenoh.controllers.padding import unstacked
from dcf_zenoh.controllers.piggyback import Piggyback, PiggybackTable
from dcf_zenoh.plant import Array

PATIENCE = 3  # rounds per hop, and one hop more, for the states of a step
Signs = Mapping[tuple[int, int], Array]


@runtime_checkable
class Signed(Protocol):
    """What a problem has whose agents must choose alike, in pairs, before they solve it; it is `SignedProblem` then."""

    def signs(self, states: Mapping[int, Array]) -> Signs:
        """The choice that `states` ask for in each pair i < j of this agent and another of whom both are known.

        Arrays of one shape (n,), whose meaning is the problem's affair.
        """


@dataclass(frozen=True)
class Sight:
    """What an agent goes by in one control step.

    Attributes:
        states: Agent -> [position, velocity], shape (2 d,), of all agents, at this step's beginning.
        lost: Agents of which nothing new came for too long; their states are their last positions, at rest.
        predicted: How many states are predicted from those of an earlier step.
        signs: Pair i < j -> choice, of the pairs that this agent is in, without lost agents. Empty if the problem
            has none.
    """

    states: Mapping[int, Array]
    lost: tuple[int, ...]
    predicted: int
    signs: Signs


class FleetStates:
    """Keeps track of the other agents, by tables that ride on every message of every round.

    A step begins with rounds of nothing but tables, until all states of the step are there or `PATIENCE` is at its
    end: states predicted at constant velocity choose signs at another moment than measured ones do, and the motion is
    worse for it. Both ends of a pair that know both states of this step choose alike. Where one was not heard, the
    choice counts that the lower id made for this step in the step before, which had all the rounds of a step to get
    about. It was made from states as they were then, not as they were predicted for now: signs that change after the
    coordinate has are safe, signs that change before it give up the barrier that was kept.

    Args:
        me: This agent.
        problem: What is to be solved; `Signed` or not.
        sample_time: t_s, in s.
        lost_after: An agent is lost when its newest state is older than this, in s.
    """

    def __init__(self, me: Me, problem: object, sample_time: float, lost_after: float) -> None:
        self._me = me
        self._problem = problem if isinstance(problem, Signed) else None
        self._sample_time = sample_time
        self._age_max = int(lost_after / sample_time + 1e-9)  # steps
        self._states = PiggybackTable("states")  # (agent,) -> its state at that step
        self._signs = PiggybackTable("signs")  # pair -> its signs in that step and in the next, shape (2, n)
        self.carrier = Piggyback(self._states, self._signs)

    @property
    def unknown(self) -> list[int]:
        """Agents of which nothing was ever heard."""
        return [i for i in self._me.agents if (i,) not in self._states.rows]

    def meet(self, own: Array, step: int) -> Dialogue[Sight | None]:
        """Share states: for as many rounds as the graph's diameter, then with `PATIENCE` until those of this step are
        there, then until every agent is known at all.

        Args:
            own: The state of this agent, shape (2 d,).
            step: Number of the control step.

        Returns:
            What to go by; None if there is no time left for it.
        """
        self._states.put((self._me.id,), step, own)
        rounds, diameter = 0, self._me.neighbourhood.diameter
        while rounds < diameter or self.unknown or (rounds < PATIENCE * (diameter + 1) and self._outdated(step)):
            if not (yield from self.carrier.alone()):
                return None
            rounds += 1
        ages = {i: step - self._states.rows[(i,)].step for i in self._me.agents}
        lost = tuple(i for i, age in ages.items() if age > self._age_max)
        states = {i: self._predicted(i, step) for i in ages}
        signs = self._signs_in(step, lost)
        for pair, following in self._chosen(step, lost).items():
            if pair[0] == self._me.id:
                self._signs.put(pair, step, np.array([signs[pair], following]))
        return Sight(states, lost, sum(0 < age <= self._age_max for age in ages.values()), signs)

    def disagreements(self, sight: Sight, step: int) -> int:
        """Pairs in which the lower id went by other signs in `step` than those of `sight`, as far as is known now."""
        count = 0
        for pair, used in sight.signs.items():
            known = self._signs.rows.get(pair)
            count += known is not None and known.step == step and not np.array_equal(known.value[0], used)
        return count

    def _signs_in(self, step: int, lost: tuple[int, ...]) -> dict[tuple[int, int], Array]:
        """What this agent's pairs go by in `step`.

        That is what measured states ask for, or else the newest choice known, or else what predicted states ask for.
        """
        signs = self._chosen(step, lost)
        for pair in signs:
            known = self._signs.rows.get(pair)
            heard = all(self._states.rows[(i,)].step == step for i in pair)
            if not heard and known is not None and step - known.step <= self._age_max:
                signs[pair] = known.value[0 if known.step == step else 1]
        return signs

    def _outdated(self, step: int) -> bool:
        """Whether the state of any agent that is not lost is of an earlier step than `step`."""
        return any(0 < step - state.step <= self._age_max for state in self._states.rows.values())

    def _chosen(self, step: int, lost: tuple[int, ...]) -> dict[tuple[int, int], Array]:
        """What the states at `step` ask for."""
        if self._problem is None:
            return {}
        return dict(self._problem.signs({i: self._predicted(i, step) for i in self._me.agents if i not in lost}))

    def _predicted(self, agent: int, step: int) -> Array:
        """The state of a known agent at `step`: at constant velocity since its newest entry, or at rest if lost."""
        then, state = self._states.rows[(agent,)]
        position, velocity = np.split(unstacked(state), 2)
        if step - then > self._age_max:
            return np.concatenate((position, np.zeros_like(velocity)))
        return np.concatenate((position + velocity * ((step - then) * self._sample_time), velocity))
