"""The remedy for agents that stand in each other's way: whoever is stuck turns its own target aside for a while."""

import math
from collections import deque

import numpy as np

from dcf_zenoh.plant import Array

GAIN = 0.05  # m that an agent must come nearer to its target ...
WATCHED = 1.0  # s in which it must
FAR = 0.1  # m from the target; nearer, nobody is stuck
TURN = math.radians(60)
OTHER_WAY = 3  # every so many detours of an agent go to the right
LASTS = 4.0  # s


class Detour:
    """Where an agent aims: at its target, or aside of it while it is stuck.

    An agent is stuck that has come less than `GAIN` nearer to its target in the last `WATCHED`, and is farther than
    `FAR` from it. For `LASTS` it aims where its target would be if the plane were turned by `TURN` about the agent, to
    the left, from wherever it is then. All turn the same way, so that agents in a knot go round each other as on a
    roundabout. Where two that are almost there must change sides the short way is to the right, so every third detour
    of an agent goes there. No agent needs to know of another's detour; the constraints they share are what they were.
    At its first step an agent has come no nearer yet, and counts as stuck: a fleet starts with a roundabout.

    Args:
        target: Where the agent wants to be, shape (2,), m.
        sample_time: s.

    Attributes:
        begun: How many detours there have been.

    Source: a turn to an agreed side in a deadlock is the right-hand heuristic of Zhou, Wang, Bandyopadhyay, Schwager,
    "Fast, on-line collision avoidance for dynamic vehicles using buffered Voronoi cells", IEEE RA-L 2017. The numbers
    are ours, chosen on random swaps that `benchmarks/swaps.py` does not fly. To go by progress frees more of them than
    to go by a low speed, as agents in a knot may circle in it.
    """

    def __init__(self, target: Array, sample_time: float) -> None:
        self._target = target
        self._lasts = round(LASTS / sample_time)
        self._left = 0
        self._distances: deque[float] = deque(maxlen=1 + max(1, round(WATCHED / sample_time)))
        self.begun = 0

    def aim(self, state: Array) -> Array:
        """Where to aim in this control step, shape (2,), m; to be asked once in every step.

        Args:
            state: The agent's [position, velocity], shape (2 d,).
        """
        position = state[:2]
        way = self._target - position
        self._distances.append(math.hypot(*way))
        if self._left:
            self._left -= 1
        elif self._stuck():
            self._left = self._lasts
            self.begun += 1
        if not self._left:
            return self._target
        turn = TURN if self.begun % OTHER_WAY else -TURN
        cos, sin = math.cos(turn), math.sin(turn)
        aside: Array = position + np.array([[cos, -sin], [sin, cos]]) @ way
        return aside

    def _stuck(self) -> bool:
        known = self._distances
        watched = len(known) in (1, known.maxlen)
        return watched and known[-1] > FAR and known[0] - known[-1] < GAIN
