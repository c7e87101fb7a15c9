"""One agent's share of a problem as arrays, for a solver that has the shares of all agents, and for messages."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, runtime_checkable

import numpy as np

from dcf_zenoh.message import Payload, Value
from dcf_zenoh.plant import Array, nothing

NO_BOUND = 1e30  # stands for infinity in a payload, whose numbers must be finite; OSQP takes it for infinity too


@dataclass(frozen=True)
class Share:
    """One agent's part of an affine variational inequality over the decisions u of a fleet, with kinks.

    Agent i minimises, over its u_i, a cost whose gradient is F_i(u) = H u_i + g + K sigma, plus the sum over k of
    absolute_k |u_k - kink_k|. sigma is the mean over the fleet of Phi_j u_j + phi_j. Its bounds are lower <= u_i <=
    upper, and the shared constraints are sum_i (A_i u_i - b_i) <= 0, or = 0. Convex quadratic programs are the special
    case in which F is a gradient.

    Attributes:
        H: Shape (n, n).
        g: Shape (n,).
        lower: Shape (n,); -inf where there is no bound.
        upper: Shape (n,); inf where there is no bound.
        K: Shape (n, s).
        Phi: Shape (s, n).
        phi: Shape (s,).
        A: Shape (rows, n).
        b: Shape (rows,).
        T: Shape (m, n). Shared constraints that are not linear depend on outputs T u + t; they are not in the share.
        t: Shape (m,).
        absolute: Shape (n,), not negative; empty for zeros.
        kink: Shape (n,); empty for zeros.
        common: All agents decide on the same u, the one with the least sum of costs.
        equality: The shared constraints are equations.
    """

    H: Array
    g: Array
    lower: Array
    upper: Array
    K: Array = field(default_factory=nothing)
    Phi: Array = field(default_factory=nothing)
    phi: Array = field(default_factory=nothing)
    A: Array = field(default_factory=nothing)
    b: Array = field(default_factory=nothing)
    T: Array = field(default_factory=nothing)
    t: Array = field(default_factory=nothing)
    absolute: Array = field(default_factory=nothing)
    kink: Array = field(default_factory=nothing)
    common: bool = False
    equality: bool = False

    def to_payload(self, agent: int) -> dict[str, Value]:
        """Return the entries of a payload that describe the share of `agent`; bounds are at most `NO_BOUND`."""
        bounds = {"lower": self.lower.clip(-NO_BOUND), "upper": self.upper.clip(max=NO_BOUND)}
        return {f"{agent}.{name}": np.asarray(value) for name, value in {**self._filled(), **bounds}.items()}

    @classmethod
    def all_in(cls, payload: Payload) -> dict[int, "Share"]:
        """Return agent -> share, of all shares in a payload; a bound of `NO_BOUND` is infinite again."""
        found: dict[int, dict[str, Any]] = {}
        for key, value in payload.items():
            agent, dot, name = key.partition(".")
            if dot and agent.isdecimal():
                found.setdefault(int(agent), {})[name] = _unbounded(value) if name in ("lower", "upper") else value
        return {agent: cls(**each) for agent, each in sorted(found.items())}

    def _filled(self) -> Mapping[str, Any]:
        return {each.name: getattr(self, each.name) for each in fields(self)}


def _unbounded(bounds: Any) -> Array:
    result: Array = np.where(abs(bounds) < NO_BOUND, bounds, np.copysign(np.inf, bounds))
    return result


@runtime_checkable
class Shareable(Protocol):
    """A problem that can be written as arrays, to be solved in one place."""

    def share(self) -> Share:
        """Return this agent's share of the problem as arrays."""
