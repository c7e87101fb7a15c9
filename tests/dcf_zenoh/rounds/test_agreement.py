import math
import random

from hypothesis import given
from hypothesis import strategies as st

from dcf_zenoh.graph import Graph
from dcf_zenoh.message import Last, Message
from dcf_zenoh.rounds.agreement import Agreement


def random_strongly_connected(count: int, rng: random.Random) -> Graph:
    """Return a directed cycle in random order with some more links."""
    order = rng.sample(range(count), count)
    links = {(order[k], order[(k + 1) % count]) for k in range(count)} if count > 1 else set()
    links |= {(i, j) for i in range(count) for j in range(count) if i != j and rng.random() < 0.2}
    return Graph.of(range(count), links)


def play(
    graph: Graph, residuals: list[list[float]], arrived: list[bool], margin: int = 0
) -> tuple[list[int], list[bool]]:
    """Return in which round each agent leaves, and whether it then knows that all have arrived."""
    agreements = {
        i: Agreement(graph.diameter, len(graph.in_neighbours(i)), 1.0, margin, arrived=arrived[i]) for i in graph.agents
    }
    left: dict[int, int] = {}
    for round, now in enumerate(residuals):
        headers = {i: agreements[i].header(now[i]) for i in graph.agents}
        sent = {
            i: Message(i, 0, round, 0, round, 0, h.stop_at, h.arrived_hops, 0, Last.NO, h.residuals, (), {})
            for i, h in headers.items()
        }
        for i in graph.agents:
            heard = [sent[j] for j in graph.in_neighbours(i)]
            if agreements[i].conclude(now[i], heard, round):
                left.setdefault(i, round)
        if left:
            break
    return [left.get(i, -1) for i in graph.agents], [agreements[i].all_arrived for i in graph.agents]


@given(st.integers(1, 7), st.integers(0, 2**32), st.integers(0, 3))
def test_all_agents_leave_in_the_same_round_the_earliest_possible(count: int, seed: int, margin: int) -> None:
    rng = random.Random(seed)
    graph = random_strongly_connected(count, rng)
    quiet_from = rng.randrange(5)
    residuals = [
        [rng.uniform(0, 0.9) if round >= quiet_from else rng.uniform(0.5, 5) for _ in range(count)]
        for round in range(30)
    ]
    below = next(r for r, now in enumerate(residuals) if max(now) < 1.0)
    left, _ = play(graph, residuals, [True] * count, margin)
    assert left == [below + max(1, graph.diameter) - 1 + margin] * count


@given(st.integers(1, 7), st.integers(0, 2**32), st.data())
def test_all_know_that_all_have_arrived_exactly_when_they_have(count: int, seed: int, data: st.DataObject) -> None:
    graph = random_strongly_connected(count, random.Random(seed))
    arrived = data.draw(st.lists(st.booleans(), min_size=count, max_size=count))
    rounds = [[math.inf] * count] * (graph.diameter + 1)
    _, known = play(graph, rounds[: max(1, graph.diameter)], arrived)
    assert known == [all(arrived)] * count
    assert play(graph, rounds, arrived)[1] == [all(arrived)] * count


def test_no_agent_concludes_that_all_have_arrived_before_it_has_heard_of_all() -> None:
    path = Graph.of(range(4), [(i, j) for i in range(4) for j in (i - 1, i + 1) if 0 <= j < 4])
    assert play(path, [[math.inf] * 4] * 2, [True] * 4)[1] == [False] * 4
