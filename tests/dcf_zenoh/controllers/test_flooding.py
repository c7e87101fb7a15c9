"""Every agent has all states after as many rounds as the graph's diameter."""

import numpy as np

from dcf_zenoh.controllers.flooding import share_states
from dcf_zenoh.graph import Graph
from dcf_zenoh.testing import converse, fleet_of
from topologies.path import path


def test_states_of_bodies_in_the_plane_and_in_space_reach_all_agents() -> None:
    own = {1: np.array([1.0, 2.0, 0.1, 0.2]), 2: np.arange(6.0), 3: np.array([3.0, 4.0, 0.3, 0.4])}
    fleet = fleet_of(Graph.of((1, 2, 3), path((1, 2, 3))))
    results = converse({i: share_states(me, own[i]) for i, me in fleet.items()}, fleet, 2)
    for states, _ in results.values():
        assert list(states) == [1, 2, 3]
        for agent, state in states.items():
            np.testing.assert_array_equal(state, own[agent])
