"""The remedy for agents that stand in each other's way: whoever is stuck turns its own target aside for a while."""

import math

import numpy as np

from dcf_zenoh.plant import Array

SLOW = 0.1  # m/s
FAR = 0.1  # m
TURN = math.radians(60)
LASTS = 15  # steps


class Detour:
    """Where an agent aims: at its target, or aside of it while it is stuck.

    An agent is stuck that is slower than `SLOW` and farther than `FAR` from its target. For the next `LASTS` steps it
    aims where its target would be if the plane were turned by `TURN` about the agent, to the left, from wherever it is
    then. All turn the same way, so that agents in a knot go round each other as on a roundabout. No agent needs to know
    of another's detour; the constraints they share are what they were. An agent at rest at the start of a run counts as
    stuck, as it has nothing to go by that tells a start from a deadlock.

    Args:
        target: Where the agent wants to be, shape (2,), m.

    Attributes:
        begun: How many detours there have been.

    Source: measured on prototypes of this game. The same idea, a turn to an agreed side in a deadlock, is the
    right-hand heuristic of Zhou, Wang, Bandyopadhyay, Schwager, "Fast, on-line collision avoidance for dynamic
    vehicles using buffered Voronoi cells", IEEE RA-L 2017.
    """

    def __init__(self, target: Array) -> None:
        self._target = target
        self._left = 0
        self.begun = 0

    def aim(self, state: Array) -> Array:
        """Where to aim in this control step, shape (2,), m; to be asked once in every step.

        Args:
            state: The agent's [position, velocity], shape (2 d,).
        """
        position, velocity = np.split(state, 2)
        way = self._target - position[:2]
        if self._left:
            self._left -= 1
        elif math.hypot(*velocity[:2]) < SLOW and math.hypot(*way) > FAR:
            self._left = LASTS
            self.begun += 1
        if not self._left:
            return self._target
        cos, sin = math.cos(TURN), math.sin(TURN)
        aside: Array = position[:2] + np.array([[cos, -sin], [sin, cos]]) @ way
        return aside
