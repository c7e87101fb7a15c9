"""Tracking of a mean by relaxed ADMM over the edges, which tolerates lost and late messages."""

from dataclasses import dataclass

from dcf_zenoh.algorithms.needs import Fraction
from dcf_zenoh.plant import Array
from dcf_zenoh.spec import PositiveFloat


@dataclass(frozen=True)
class TrackerOptions:
    """Options of a `MeanTracker`.

    Attributes:
        penalty: rho; the larger, the more the neighbours' estimates weigh.
        renew: alpha in (0, 1], the fraction by which an edge variable follows a received message.
    """

    penalty: PositiveFloat = 1.0
    renew: Fraction = 0.9


class MeanTracker:
    """Tracks the fleet's mean of a vector theta that each agent holds, by relaxed ADMM over the edges.

    The agents minimise sum_i |x_i - theta_i|^2 / 2 under x_i = x_j on every edge; the solution is the mean, from any
    start. An edge takes part once a message was received over it: an edge that stays silent would pull x towards its
    start.

    Source: Carnevale, Bastianello, Notarstefano, Carli, "ADMM-Tracking Gradient for Distributed Optimization over
    Asynchronous and Unreliable Networks", IEEE Transactions on Automatic Control, 2025: its robust variant, with q for
    z.

    Args:
        theta: First vector of this agent, shape (n,).
        options: rho and alpha.

    Attributes:
        mean: x_i, this agent's estimate of the mean, shape (n,).
    """

    def __init__(self, theta: Array, options: TrackerOptions) -> None:
        self._theta = self.mean = theta
        self._penalty, self._renew = options.penalty, options.renew
        self._q: dict[int, Array] = {}  # edges over which a message was received

    def track(self, theta: Array) -> None:
        """Replace this agent's vector and update the estimate."""
        self._theta = theta
        self.combine()

    def combine(self) -> None:
        """Update the estimate: x = (theta + sum_j q_ij) / (1 + rho d)."""
        total = self._theta
        for _, q in sorted(self._q.items()):
            total = total + q
        self.mean = total / (1 + self._penalty * len(self._q))

    def message(self, neighbour: int) -> Array:
        """Return the message to `neighbour`, -q_ij + 2 rho x, shape (n,)."""
        return 2 * self._penalty * self.mean - self._edge(neighbour)

    def update(self, neighbour: int, message: Array) -> None:
        """Update the edge variable by a message of `neighbour`: q_ij <- (1 - alpha) q_ij + alpha m_ji."""
        self._q[neighbour] = (1 - self._renew) * self._edge(neighbour) + self._renew * message

    def _edge(self, neighbour: int) -> Array:
        """Return q_ij; before the first message rho x, with which the edge does not move x."""
        return self._q[neighbour] if neighbour in self._q else self._penalty * self.mean
