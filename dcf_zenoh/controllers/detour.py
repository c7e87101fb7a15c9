"""Remedy for deadlocks: an agent that is stuck turns its target aside for a while."""

import math
from collections import deque

import numpy as np

from dcf_zenoh.plant import Array

GAIN = 0.05  # m; progress towards the target below which an agent is stuck ...
WATCHED = 1.0  # s; ... over this time
FAR = 0.1  # m from the target; an agent nearer than this is never stuck
TURN = math.radians(60)
OTHER_WAY = 3  # every third detour of an agent turns to the right
LASTS = 4.0  # s; duration of a detour


class Detour:
    """Chooses the point that an agent aims at: its target, or a point aside of it while the agent is stuck.

    An agent is stuck if it has come less than `GAIN` nearer to its target in the last `WATCHED` and is farther than
    `FAR` from it. For the next `LASTS` it aims at its target turned to the left by `TURN` about its present position.
    All agents turn the same way, so that agents in a knot circulate as on a roundabout. Where two agents that are
    almost at their targets must change sides, the short way is to the right, so every third detour of an agent turns
    right. An agent need not know of another's detour: the shared constraints are unchanged. In its first step an agent
    has made no progress and counts as stuck, so a fleet starts with a roundabout.

    Args:
        target: Target of the agent, shape (2,), in m.
        sample_time: Control period, in s.

    Attributes:
        begun: Number of detours so far.

    Source: a turn to an agreed side in a deadlock is the right-hand heuristic of Zhou, Wang, Bandyopadhyay, Schwager,
    "Fast, on-line collision avoidance for dynamic vehicles using buffered Voronoi cells", IEEE RA-L 2017. The numbers
    are ours, chosen on random swaps that `benchmarks/swaps.py` does not fly. A test of progress frees more of them than
    a test of speed, because agents in a knot may circle in it.
    """

    def __init__(self, target: Array, sample_time: float) -> None:
        self._target = target
        self._lasts = round(LASTS / sample_time)
        self._left = 0
        self._distances: deque[float] = deque(maxlen=1 + max(1, round(WATCHED / sample_time)))
        self.begun = 0

    def aim(self, state: Array) -> Array:
        """Return the point to aim at in this control step, shape (2,), in m. Call it once per step.

        Args:
            state: Position and velocity of the agent, shape (2 d,).
        """
        position = state[:2]
        offset = self._target - position
        self._distances.append(math.hypot(*offset))
        if self._left:
            self._left -= 1
        elif self._stuck():
            self._left = self._lasts
            self.begun += 1
        if not self._left:
            return self._target
        turn = TURN if self.begun % OTHER_WAY else -TURN
        cos, sin = math.cos(turn), math.sin(turn)
        aside: Array = position + np.array([[cos, -sin], [sin, cos]]) @ offset
        return aside

    def _stuck(self) -> bool:
        distances = self._distances
        watched = len(distances) in (1, distances.maxlen)
        return watched and distances[-1] > FAR and distances[0] - distances[-1] < GAIN
