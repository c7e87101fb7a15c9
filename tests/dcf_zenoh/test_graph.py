from collections.abc import Callable
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcf_zenoh.errors import TopologyError
from dcf_zenoh.graph import Graph, Neighbourhood, laplacian, metropolis, uneven, uniform
from dcf_zenoh.plant import Array


@st.composite
def graphs(draw: st.DrawFn, *, undirected: bool) -> Graph:
    agents = sorted(draw(st.sets(st.integers(0, 50), min_size=1, max_size=8)))
    pairs = list(permutations(agents, 2))
    links = draw(st.lists(st.sampled_from(pairs), max_size=30)) if pairs else []
    return Graph.of(agents, [*links, *((j, i) for i, j in links)] if undirected else links)


def floyd_warshall(graph: Graph) -> dict[tuple[int, int], float]:
    hops = {
        (i, j): 0.0 if i == j else 1.0 if (i, j) in graph.links else np.inf for i in graph.agents for j in graph.agents
    }
    for k in graph.agents:
        for i in graph.agents:
            for j in graph.agents:
                hops[i, j] = min(hops[i, j], hops[i, k] + hops[k, j])
    return hops


@pytest.mark.parametrize("scheme", [metropolis, laplacian])
@given(graph=graphs(undirected=True))
def test_weights_of_undirected_graphs_are_symmetric_and_doubly_stochastic(
    scheme: Callable[[Graph], Array], graph: Graph
) -> None:
    weights = scheme(graph)
    assert np.array_equal(weights, weights.T)
    assert np.allclose(weights.sum(axis=1), 1.0, rtol=0, atol=1e-12)
    assert np.allclose(weights.sum(axis=0), 1.0, rtol=0, atol=1e-12)
    assert (weights >= 0).all()
    assert (np.diag(weights) > 0).all()


@pytest.mark.parametrize("scheme", [uniform, uneven])
@given(graph=graphs(undirected=False))
def test_weights_of_directed_graphs_are_row_stochastic_on_the_links_alone(
    scheme: Callable[[Graph], Array], graph: Graph
) -> None:
    weights = scheme(graph)
    assert np.allclose(weights.sum(axis=1), 1.0, rtol=0, atol=1e-12)
    for row, i in enumerate(graph.agents):
        for column, j in enumerate(graph.agents):
            assert (weights[row, column] > 0) == (i == j or (j, i) in graph.links)


@given(graphs(undirected=False))
def test_diameter_is_the_longest_of_all_shortest_paths(graph: Graph) -> None:
    longest = max(floyd_warshall(graph).values())
    if np.isfinite(longest):
        assert graph.diameter == longest
    else:
        with pytest.raises(TopologyError, match=r"the graph is not (strongly )?connected: nothing agent \d+ sends can"):
            _ = graph.diameter


@given(graphs(undirected=False))
def test_distances_are_shortest_paths(graph: Graph) -> None:
    hops = floyd_warshall(graph)
    for source in graph.agents:
        assert graph.distances(source) == {j: hops[source, j] for j in graph.agents if np.isfinite(hops[source, j])}


@given(graphs(undirected=False))
def test_neighbours_are_the_links_seen_from_one_end(graph: Graph) -> None:
    for agent in graph.agents:
        assert graph.in_neighbours(agent) == tuple(sorted(i for i, j in graph.links if j == agent))
        assert graph.out_neighbours(agent) == tuple(sorted(j for i, j in graph.links if i == agent))


def test_link_to_an_absent_agent_is_refused() -> None:
    with pytest.raises(TopologyError, match=r"link 1 -> 3: there is no agent 3; agents are \[1, 2\]"):
        Graph.of((2, 1), [(1, 3)])


def test_link_to_itself_is_refused() -> None:
    with pytest.raises(TopologyError, match="link 1 -> 1: an agent needs no link to itself"):
        Graph.of((1, 2), [(1, 1)])


@pytest.mark.parametrize("link", [(1,), (1, 2, 3), 5])
def test_link_that_is_no_pair_is_refused(link: object) -> None:
    with pytest.raises(TopologyError, match=r"a link is a pair \(sender, receiver\), not"):
        Graph.of((1, 2), [link])  # type: ignore[list-item]


def test_metropolis_weights_name_the_link_without_opposite() -> None:
    with pytest.raises(TopologyError, match="link 2 -> 1 has no opposite; use weights = 'uniform'"):
        metropolis(Graph.of((1, 2), [(2, 1)]))


@given(graphs(undirected=True), st.floats(0.01, 0.99))
def test_laplacian_weights_are_a_step_along_the_laplacian(graph: Graph, part: float) -> None:
    adjacency = np.array([[float((j, i) in graph.links) for j in graph.agents] for i in graph.agents])
    degrees = adjacency.sum(axis=1)
    step = part / max(1.0, degrees.max())
    expected = np.eye(len(degrees)) - step * (np.diag(degrees) - adjacency)
    np.testing.assert_allclose(laplacian(graph, step), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("step", [0.5, 0.7])
def test_a_laplacian_step_that_is_too_large_is_refused(step: float) -> None:
    ring = Graph.of((1, 2, 3), permutations((1, 2, 3), 2))
    with pytest.raises(TopologyError, match=r"weight_step must be less than 1 / 2, as there is an agent with 2 neigh"):
        laplacian(ring, step)


def test_neighbourhood_is_one_row_of_the_weights() -> None:
    graph = Graph.of((1, 2, 3), [(1, 2), (2, 1), (2, 3), (3, 2)])
    hood = Neighbourhood.of(graph, 3, metropolis(graph))
    assert hood.receives_from == hood.sends_to == (2,)
    assert hood.weights == pytest.approx({2: 1 / 3, 3: 2 / 3})
    assert hood.diameter == 2
    assert hood.doubly_stochastic


def test_uniform_weights_of_a_star_are_not_doubly_stochastic() -> None:
    graph = Graph.of((1, 2, 3), [(1, 2), (2, 1), (1, 3), (3, 1)])
    assert not Neighbourhood.of(graph, 1, uniform(graph)).doubly_stochastic
