"""Instants at which an agent activates in asynchronous mode."""

import numpy as np


class ActivationSchedule:
    """Activation instants of one agent: a period that varies at random.

    Args:
        period: Mean time between two activations, ns.
        jitter: Largest deviation either way, uniformly distributed, ns.
        rng: Random numbers, seeded by fleet and agent.
    """

    def __init__(self, period: int, jitter: int, rng: np.random.Generator) -> None:
        self._period = period
        self._jitter = jitter
        self._rng = rng

    def after(self, instant: int) -> int:
        """Return the activation that follows one at `instant`, ns; strictly later."""
        change = round(self._jitter * self._rng.uniform(-1.0, 1.0)) if self._jitter else 0
        return instant + max(1, self._period + change)
