"""Average consensus."""

from typing import Any

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.problems.problem import MeanProblem


@needs(MeanProblem, doubly_stochastic=True, alike=True)
def average_consensus(problem: MeanProblem, me: Me) -> Dialogue[Result]:
    """Find the mean of all agents' values by repeated mixing: ``x+ = sum_j w_ij x_j``.

    Converges linearly; the rate is the second largest modulus of the weight matrix's eigenvalues. A lost message leaves
    a bias. The residual is the change of the agent's estimate in the last round.

    Source: Xiao and Boyd, "Fast linear iterations for distributed averaging", Systems & Control Letters, 2004, eq. (1).

    Raises:
        AlgorithmError: The weights are not doubly stochastic, so the limit would not be the mean.
    """
    x: Any = problem.value
    change = float("inf")
    while True:
        inbox = yield {"x": x}, change
        new = me.mix(inbox, "x")
        change, x = float(abs(new - x).max()), new
        me.note(x=x)
        if inbox.stop:
            return me.result(x)
