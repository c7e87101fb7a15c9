"""Games whose players meet in the mean of their contributions and in shared affine constraints."""

from typing import Protocol

from dcf_zenoh.plant import Array


class CoupledGame(Protocol):
    """What TRADES asks of a game: shapes (n,) for decisions, (s,) for the aggregate, (rows,) for the coupling."""

    A: Array
    rows: int

    def start(self, last: Array | None) -> Array:
        """Initial decision."""

    def contribution(self, u: Array) -> Array:
        """phi(u), whose mean over the agents is sigma."""

    def coupling(self, u: Array) -> Array:
        """A u - b; the sum over the agents must not be positive."""

    def gradient(self, u: Array, sigma: Array) -> Array:
        """Pseudo-gradient of the agent's cost."""

    def project(self, u: Array) -> Array:
        """Nearest admissible decision."""
