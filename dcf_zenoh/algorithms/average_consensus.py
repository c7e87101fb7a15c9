"""Average consensus."""

from collections.abc import Generator
from typing import Any

from dcf_zenoh.algorithms.algorithm import Inbox, Me, Result
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.messaging.message import Payload
from dcf_zenoh.problems.average import Average


def average_consensus(problem: Average, me: Me) -> Generator[tuple[Payload, float], Inbox, Result]:
    """Every agent ends with the mean of all agents' values: ``x+ = sum_j w_ij x_j``.

    The residual is the change of the own estimate in the last round.

    Source: Xiao and Boyd, "Fast linear iterations for distributed averaging", 2004, eq. (1).

    Raises:
        AlgorithmError: The weights are not doubly stochastic: the limit would not be the mean.
    """
    if not me.neighbourhood.doubly_stochastic:
        raise AlgorithmError(
            "average_consensus needs doubly stochastic weights; these are not (use an undirected topology with"
            " weights = 'metropolis')"
        )
    x: Any = problem.value
    change = float("inf")
    while True:
        inbox = yield {"x": x}, change
        new = me.mix(inbox, "x")
        change, x = float(abs(new - x).max()), new
        if inbox.stop:
            return me.result(x)
