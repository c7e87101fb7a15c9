"""One agent gathers the problems of all, solves them, and tells the answer."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.message import Value
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.central import solve_together
from dcf_zenoh.problems.problem import AggregativeGame, ConsensusProblem, CoupledProblem, Game
from dcf_zenoh.problems.share import Share, Shareable

ANSWER = "answer."  # begins the names of entries of the answer


@needs(ConsensusProblem, CoupledProblem, Game, AggregativeGame, traits=("linear",))
def centralised(problem: Shareable, me: Me, *, hub: int | None = None) -> Dialogue[Result]:
    """Every agent passes on the shares of the problem that it knows, and the answer once it is there.

    The hub knows all shares after as many rounds as it is away from the farthest agent, and asks OSQP; the others have
    the answer as many rounds later. Nothing is lost for good if messages are. The residual is 0 once an agent has the
    answer. An agent that has to stop before has no decision: its last one, or zeros, stand for it.

    Args:
        problem: This agent's share.
        me: This agent.
        hub: Who solves; None: the lowest id.

    Raises:
        AlgorithmError: There is no agent `hub`, the problem cannot be told as arrays, or it has no solution; then the
            solver's status is in the message.
    """
    solver = me.agents[0] if hub is None else hub
    if solver not in me.agents:
        raise AlgorithmError(f"centralised: hub must be one of the agents {list(me.agents)}, not {solver}")
    if not isinstance(problem, Shareable):
        raise AlgorithmError(f"centralised needs a problem with share(), which {type(problem).__name__} has not")
    share = problem.share()
    known: dict[str, Value] = share.to_payload(me.id)
    answer: dict[str, Value] = {}
    while True:
        if me.id == solver and not answer and len(shares := Share.all_in(known)) == me.count:
            answer = {f"{ANSWER}{i}": u for i, u in solve_together(shares).items()}
        own = answer.get(f"{ANSWER}{me.id}")
        inbox = yield answer or known, 0.0 if answer else float("inf")
        for payload in inbox.values():
            told = {name: value for name, value in payload.items() if name.startswith(ANSWER)}
            answer = answer or told
            known = known if told else {**payload, **known}
        if inbox.stop:
            own = answer.get(f"{ANSWER}{me.id}")
            stand_in: Array = np.zeros(len(share.g)) if me.last is None else me.last
            return me.result(stand_in if own is None else np.asarray(own))
