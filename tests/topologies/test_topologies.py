from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dcf_zenoh.errors import TopologyError
from dcf_zenoh.graph import Graph, metropolis
from dcf_zenoh.plugins import create, known, load
from dcf_zenoh.testing import check_topology
from topologies.complete import complete
from topologies.edges import edges
from topologies.erdos_renyi import erdos_renyi
from topologies.geometric import geometric
from topologies.grid import grid
from topologies.path import path
from topologies.regular import regular
from topologies.ring import ring
from topologies.star import star

AGENTS = (2, 3, 5, 7, 11, 13)
NEEDED: dict[str, dict[str, Any]] = {"edges": {"links": [[2, 3], [3, 5], [5, 7], [7, 11], [11, 13]]}}


@pytest.mark.parametrize("kind", sorted(known("topologies")))
def test_every_kind_connects_its_agents_in_both_directions(kind: str) -> None:
    links = create(load("topologies", kind, Path()), {"agents": AGENTS}, NEEDED.get(kind, {}), "topology")
    graph = Graph.of(AGENTS, links)
    assert graph.undirected
    assert 1 <= graph.diameter < len(AGENTS)
    assert metropolis(graph).sum() == pytest.approx(len(AGENTS))


@pytest.mark.parametrize("kind", sorted(set(known("topologies")) - {"edges"}))
def test_every_kind_is_defined_for_one_and_for_two_agents(kind: str) -> None:
    plugin = load("topologies", kind, Path())
    assert list(plugin((4,))) == []
    assert set(plugin((4, 9))) == {(4, 9), (9, 4)}


@pytest.mark.parametrize("kind", sorted(set(known("topologies")) - {"edges"}))
def test_every_kind_keeps_the_contract(kind: str) -> None:
    check_topology(load("topologies", kind, Path()))


@pytest.mark.parametrize(
    ("topology", "error", "text"),
    [
        (lambda agents: [(agents[0], agents[0])], TopologyError, "an agent needs no link to itself"),
        (lambda agents: [(0, 1)], TopologyError, "there is no agent 0"),
        (lambda agents: [(i, i + 3) for i in agents[:-1]], TopologyError, "not strongly connected"),
        (lambda agents: np.random.default_rng().permutation(complete(agents)).tolist(), AssertionError, "repeatable"),
    ],
)  # fmt: skip
def test_a_broken_topology_is_found_out(topology: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        check_topology(topology)


def test_complete_has_diameter_one() -> None:
    assert Graph.of(AGENTS, complete(AGENTS)).diameter == 1
    assert len(complete(AGENTS)) == 30


def test_path_is_as_long_as_it_has_links() -> None:
    graph = Graph.of(AGENTS, path(AGENTS))
    assert graph.diameter == 5
    assert graph.in_neighbours(2) == (3,)


def test_ring_closes_from_the_last_to_the_first() -> None:
    graph = Graph.of(AGENTS, ring(AGENTS))
    assert graph.diameter == 3
    assert graph.in_neighbours(2) == (3, 13)


def test_directed_ring_is_heard_by_the_next_alone() -> None:
    graph = Graph.of(AGENTS, ring(AGENTS, directed=True))
    assert graph.out_neighbours(13) == (2,)
    assert graph.in_neighbours(13) == (11,)
    assert graph.diameter == 5


def test_hub_of_a_star_is_the_lowest_id_by_default() -> None:
    assert Graph.of(AGENTS, star(AGENTS)).out_neighbours(2) == AGENTS[1:]
    assert Graph.of(AGENTS, star(AGENTS, hub=7)).out_neighbours(2) == (7,)


def test_star_refuses_a_hub_that_is_no_agent() -> None:
    with pytest.raises(ValueError, match=r"hub must be one of the agents \[2, 3, 5, 7, 11, 13\], not 4"):
        star(AGENTS, hub=4)


@pytest.mark.parametrize(("rows", "columns"), [(None, None), (2, None), (None, 3), (2, 3)])
def test_grid_of_six_is_two_by_three(rows: int | None, columns: int | None) -> None:
    graph = Graph.of(AGENTS, grid(AGENTS, rows=rows, columns=columns))
    assert graph.in_neighbours(3) == (2, 5, 11)
    assert graph.in_neighbours(5) == (3, 13)
    assert graph.diameter == 3


def test_grid_of_a_prime_number_is_a_path() -> None:
    assert set(grid(AGENTS[:5])) == set(path(AGENTS[:5]))


def test_grid_names_the_sizes_that_divide_the_agents() -> None:
    with pytest.raises(ValueError, match=r"rows must divide the 6 agents, so be one of \[1, 2, 3, 6\], not 4"):
        grid(AGENTS, rows=4)
    with pytest.raises(ValueError, match="rows x columns must be 6, the number of agents, not 2 x 2 = 4"):
        grid(AGENTS, rows=2, columns=2)


def test_edges_go_both_ways_unless_directed() -> None:
    assert set(edges((1, 2), links=[(1, 2)])) == {(1, 2), (2, 1)}
    assert edges((1, 2), links=[(1, 2)], directed=True) == [(1, 2)]


@pytest.mark.parametrize("link", [(1, 3), (3, 2), (1, 1)])
def test_edges_refuse_links_that_join_no_two_agents(link: tuple[int, int]) -> None:
    with pytest.raises(TopologyError, match=r"links must be pairs of different agents among \[1, 2\], not \[\d, \d\]"):
        edges((1, 2), links=[link])


MANY = tuple(range(40))


@pytest.mark.parametrize("seed", range(5))
def test_random_graphs_are_connected_and_belong_to_their_seed(seed: int) -> None:
    for topology in (erdos_renyi, geometric, regular):
        links = topology(AGENTS, seed=seed)
        assert Graph.of(AGENTS, links).undirected
        assert topology(AGENTS, seed=seed) == links
    assert len({str(sorted(erdos_renyi(MANY, seed=each))) for each in range(seed, seed + 3)}) == 3


def test_pairs_are_joined_with_the_given_probability() -> None:
    counts = [len(erdos_renyi(MANY, probability=0.3, seed=seed)) / 2 for seed in range(30)]
    expected, deviation = 0.3 * 780, (0.3 * 0.7 * 780) ** 0.5
    assert abs(np.mean(counts) - expected) < 4 * deviation / 30**0.5
    assert 0.5 * deviation < np.std(counts) < 1.5 * deviation


def test_the_nearer_agents_are_the_neighbours() -> None:
    """In a unit square a disc of radius 0.2 has 1/8 of the area, less at its edges."""
    degrees = [len(geometric(MANY, radius=0.3, seed=seed)) / 40 for seed in range(30)]
    assert 0.6 * 39 * np.pi * 0.09 < np.mean(degrees) < 39 * np.pi * 0.09
    assert set(geometric(AGENTS, radius=1.5)) == set(complete(AGENTS))
    near, far = (set(geometric(AGENTS, radius=radius, seed=1)) for radius in (0.9, 1.1))
    assert near < far


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_everybody_has_as_many_neighbours_in_a_regular_graph(degree: int) -> None:
    graphs = [Graph.of(AGENTS, regular(AGENTS, degree=degree, seed=seed)) for seed in range(10)]
    assert {len(graph.in_neighbours(i)) for graph in graphs for i in AGENTS} == {degree}
    assert len({graph.links for graph in graphs}) > 1 or degree == 5


@pytest.mark.parametrize(
    ("draw", "text"),
    [
        (
            lambda: erdos_renyi(MANY, probability=0.02),
            "none of 1000 graphs that were drawn is connected; choose a prob",
        ),
        (lambda: geometric(MANY, radius=0.05), "is connected; choose a radius above 0.05"),
        (lambda: erdos_renyi(MANY, probability=1.5), r"probability must be in \(0, 1\], not 1.5"),
        (lambda: geometric(MANY, radius=0.0), "radius must be positive, not 0"),
        (lambda: regular(AGENTS, degree=6), "degree must be from 2 to 5 with 6 agents, not 6"),
        (lambda: regular(AGENTS, degree=1), "degree must be from 2 to 5 with 6 agents, not 1"),
        (lambda: regular(AGENTS[:5], degree=3), "degree 3 and 5 agents are both odd: there is no such graph"),
    ],
)
def test_what_cannot_be_drawn_is_refused(draw: Any, text: str) -> None:
    with pytest.raises((ValueError, TopologyError), match=text):
        draw()
