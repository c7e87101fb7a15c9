"""Bursts: messages are lost in groups."""

from collections.abc import Sequence

import numpy as np

from dcf_zenoh.faults.fault import Fault, Stage
from dcf_zenoh.faults.limits import at_least, probability
from dcf_zenoh.messaging.delivery import Delivery


class Bursts(Fault):
    """Link that is good or bad, and changes its state at random between one message and the next (Gilbert-Elliott).

    There are two ways to specify it. With `mean_loss` and `mean_length` a bad link loses every message and a good one
    none, so the numbers of messages lost in a row are geometrically distributed. With `good_to_bad` and `bad_to_good`
    each state has its own probability of loss. The state at the first message is drawn from the stationary
    distribution. The state changes with messages, not with time; messages lost by earlier faults of the chain do not
    count.

    Args:
        mean_loss: Share of messages lost in the long run, at least 0 and less than 1.
        mean_length: Mean number of messages lost in a row, at least 1.
        good_to_bad: Probability that the link turns bad before the next message.
        bad_to_good: Probability that the link turns good before the next message.
        loss_good: Probability of losing a message while the link is good; only with `good_to_bad`.
        loss_bad: Probability of losing a message while the link is bad; only with `good_to_bad`.

    Raises:
        ValueError: A value is out of its range, both ways or neither are given, or `mean_loss` is too large for
            `mean_length`.

    Source: Gilbert (1960), "Capacity of a burst-noise channel", for the chain; Elliott (1963), "Estimates of error
    rates for codes on burst-noise channels", for the loss in both states; Haßlinger and Hohlfeld (2008), "The
    Gilbert-Elliott model for packet loss in real time services on the Internet", for packets. With their p and r, the
    stationary probability of the bad state is p / (p + r) and the mean length of a stay in it is 1 / r.
    """

    STAGE = Stage.LOSS

    def __init__(
        self,
        *,
        mean_loss: float | None = None,
        mean_length: float | None = None,
        good_to_bad: float | None = None,
        bad_to_good: float | None = None,
        loss_good: float = 0.0,
        loss_bad: float = 1.0,
    ) -> None:
        by_means = mean_loss is not None or mean_length is not None
        by_chain = good_to_bad is not None or bad_to_good is not None or loss_good != 0 or loss_bad != 1
        if by_means and by_chain:
            raise ValueError("give mean_loss and mean_length, or good_to_bad and bad_to_good, not some of both")
        if mean_loss is not None and mean_length is not None:
            p, r = _chain(mean_loss, mean_length)
        elif good_to_bad is not None and bad_to_good is not None:
            p, r = probability("good_to_bad", good_to_bad), probability("bad_to_good", bad_to_good)
            if p + r == 0:
                raise ValueError("good_to_bad and bad_to_good must not both be 0")
        elif by_means:
            raise ValueError("mean_loss and mean_length must be given together")
        else:
            raise ValueError("good_to_bad and bad_to_good must be given together, or mean_loss and mean_length")
        self._turn_bad = (p, 1 - r)  # probabilities before the next message, from good and from bad
        self._loss = (probability("loss_good", loss_good), probability("loss_bad", loss_bad))
        self._stationary = p / (p + r)
        self._bad: bool | None = None

    def apply(self, delivery: Delivery, rng: np.random.Generator) -> Sequence[Delivery]:
        """Draw the next state, then whether the message is lost."""
        turn_bad = self._stationary if self._bad is None else self._turn_bad[self._bad]
        self._bad = bool(rng.random() < turn_bad)
        return () if rng.random() < self._loss[self._bad] else (delivery,)


def _chain(mean_loss: float, mean_length: float) -> tuple[float, float]:
    """Return the probabilities p of turning bad and r of turning good."""
    if not 0 <= mean_loss < 1:
        raise ValueError(f"mean_loss must be at least 0 and less than 1, not {mean_loss}")
    r = 1 / at_least("mean_length", mean_length, 1, "messages")
    most = mean_length / (1 + mean_length)
    if mean_loss > most:
        raise ValueError(
            f"mean_loss must be at most mean_length / (1 + mean_length) = {most:.4g}, not {mean_loss}:"
            " there is at least one message between two bursts"
        )
    return min(1.0, r * mean_loss / (1 - mean_loss)), r  # from mean_loss = p / (p + r)
