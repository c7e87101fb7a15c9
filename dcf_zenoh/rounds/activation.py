"""When an agent activates in asynchronous mode."""

import numpy as np


class ActivationSchedule:
    """Activation instants of one agent: a period that varies, by random numbers of its own.

    Args:
        period: Mean time between two activations, ns.
        jitter: By which it varies either way, uniformly, ns.
        rng: Seeded by fleet and agent.
    """

    def __init__(self, period: int, jitter: int, rng: np.random.Generator) -> None:
        self._period = period
        self._jitter = jitter
        self._rng = rng

    def after(self, instant: int) -> int:
        """The activation that follows one at `instant`, ns; strictly later."""
        change = round(self._jitter * self._rng.uniform(-1.0, 1.0)) if self._jitter else 0
        return instant + max(1, self._period + change)
