"""Where is the beacon? Each agent measures one bearing; together they find the place."""
import numpy as np

from dcf_zenoh.problems.problem import ConsensusProblem


class Bearing(ConsensusProblem):
    """One agent's squared distance to the line along which it sees the beacon, f(x) = weight / 2 (n'(x - place))².

    n is the normal of the line. f is constant along the line, so it is not strongly convex.

    Args:
        place: Where the agent stands, [x, y], m.
        bearing: Direction of the beacon, degrees from the x axis.
        weight: Weight of this bearing; larger for a better sensor.
    """

    size = 2
    strongly_convex = False

    def __init__(self, *, place: list[float], bearing: float, weight: float = 1.0):
        if not weight > 0:
            raise ValueError(f"weight must be positive, not {weight}")
        angle = np.radians(bearing)
        normal = np.array([-np.sin(angle), np.cos(angle)])
        self.H = weight * np.outer(normal, normal)
        self.place = np.array(place)

    def cost(self, x):
        return float((x - self.place) @ self.H @ (x - self.place)) / 2

    def gradient(self, x):
        return self.H @ (x - self.place)

    def argmin(self, slope, weight):
        """The x with the least f(x) + slope'x + weight / 2 |x|²; ADMM needs it, gradient methods do not."""
        return np.linalg.solve(self.H + weight * np.eye(2), self.H @ self.place - slope)

    def distance_to_go(self, state):
        return 0.0  # nothing moves
