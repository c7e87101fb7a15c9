"""Central solution by one agent, which gathers all problems, solves them together and returns the answer."""

import numpy as np

from dcf_zenoh.algorithms.algorithm import Dialogue, Me, Result
from dcf_zenoh.algorithms.needs import needs
from dcf_zenoh.errors import AlgorithmError
from dcf_zenoh.message import Value
from dcf_zenoh.plant import Array
from dcf_zenoh.problems.central import solve_with_residual
from dcf_zenoh.problems.problem import AggregativeGame, ConsensusProblem, CoupledProblem, Game
from dcf_zenoh.problems.share import Share, Shareable

ANSWER = "answer."  # prefix of the payload entries that hold the answer
VIOLATED = f"{ANSWER}violated"  # in an answer that violates shared constraints


@needs(ConsensusProblem, CoupledProblem, Game, AggregativeGame, traits=("linear",))
def centralised(problem: Shareable, me: Me, *, hub: int | None = None) -> Dialogue[Result]:
    """Flood all shares of the problem to one agent, the hub, and its answer back to all.

    The hub has all shares after as many rounds as there are hops to the farthest agent, and solves them; the
    others have the answer as many rounds later. Lost messages only delay it. The residual is infinite until an agent
    has the answer, then 0. An agent that must stop before decides on its last decision, or on zeros.

    Args:
        problem: This agent's share of the problem.
        me: This agent.
        hub: Id of the agent that solves; None: the lowest id.

    Raises:
        AlgorithmError: There is no agent `hub`, the problem has no `share` method, it has no solution, or none is
            found; the message tells which.
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
            found = solve_with_residual(shares, tolerant=me.tolerant)
            answer = {f"{ANSWER}{i}": u for i, u in found.decisions.items()}
            if found.violated:
                answer[VIOLATED] = 1.0
            if not found.accurate:
                me.note(inaccurate=found.residual)
        inbox = yield answer or known, 0.0 if answer else float("inf")
        for payload in inbox.values():
            received = {name: value for name, value in payload.items() if name.startswith(ANSWER)}
            answer = answer or received
            known = known if received else {**payload, **known}
        if inbox.stop:
            me.violated = VIOLATED in answer
            own = answer.get(f"{ANSWER}{me.id}")
            stand_in: Array = np.zeros(len(share.g)) if me.last is None else me.last
            return me.result(stand_in if own is None else np.asarray(own))
