from pathlib import Path

import numpy as np
import pytest

from dcf_zenoh.config import graph_of, load, weights_of
from dcf_zenoh.errors import ConfigurationError
from dcf_zenoh.graph import metropolis, uniform


def test_graph_and_weights_follow_from_the_topology(file: Path) -> None:
    fleet = load(file)
    graph = graph_of(fleet)
    assert graph.in_neighbours(1) == (2, 3)
    assert np.array_equal(weights_of(fleet.spec, graph), metropolis(graph))
    directed = load(file, changes=["topology.directed=true"])
    assert np.array_equal(weights_of(directed.spec, graph_of(directed)), uniform(graph_of(directed)))


@pytest.mark.parametrize("weights", ["auto", "metropolis"])
def test_a_step_that_the_weights_do_not_use_is_refused(weights: str, file: Path) -> None:
    text = "topology.weights: weight_step is an option of 'laplacian' alone, and the weights are 'metropolis'"
    with pytest.raises(ConfigurationError, match=text):
        load(file, changes=[f"topology.weights={weights}", "topology.weight_step=0.1"])
