"""Tracking of a mean by relaxed ADMM over the edges, which bears lost and late messages."""

from dcf_zenoh.plant import Array


class MeanTracker:
    """Tracks the mean over the fleet of a vector theta of each agent, by relaxed ADMM over the edges.

    The agents minimise sum_i |x_i - theta_i|^2 / 2 under x_i = x_j on every edge, which the mean solves, from any
    start. An edge counts once something has come over it: an edge that is silent for the whole step would pull x
    towards whatever it started from.

    Source: Carnevale, Bastianello, Notarstefano, Carli, "ADMM-Tracking Gradient for Distributed Optimization over
    Asynchronous and Unreliable Networks", IEEE Transactions on Automatic Control, 2025: its robust variant, with q for
    z.

    Args:
        theta: This agent's vector at first, shape (n,).
        penalty: rho.
        renew: alpha.

    Attributes:
        mean: x_i, this agent's estimate, shape (n,).
    """

    def __init__(self, theta: Array, penalty: float, renew: float) -> None:
        self._theta = self.mean = theta
        self._penalty, self._renew = penalty, renew
        self._q: dict[int, Array] = {}  # of the edges over which something has come

    def track(self, theta: Array) -> None:
        """Go on with a new vector of this agent."""
        self._theta = theta
        self.combine()

    def combine(self) -> None:
        """Form the estimate x = (theta + sum_j q_ij) / (1 + rho d)."""
        total = self._theta
        for _, q in sorted(self._q.items()):
            total = total + q
        self.mean = total / (1 + self._penalty * len(self._q))

    def edge(self, neighbour: int) -> Array:
        """What `neighbour` is to hear: -q_ij + 2 rho x."""
        return 2 * self._penalty * self.mean - self._edge(neighbour)

    def hear(self, neighbour: int, message: Array) -> None:
        """Take in what `neighbour` sent: q_ij <- (1 - alpha) q_ij + alpha m_ji."""
        self._q[neighbour] = (1 - self._renew) * self._edge(neighbour) + self._renew * message

    def _edge(self, neighbour: int) -> Array:
        """q_ij; before anything was heard rho x, with which the edge does not move x."""
        return self._q[neighbour] if neighbour in self._q else self._penalty * self.mean
