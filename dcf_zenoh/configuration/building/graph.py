"""The communication graph of a fleet, drawn by its topology, and the mixing weights on it."""

from pathlib import Path

from dcf_zenoh.diagnostics import reason
from dcf_zenoh.errors import PluginError, TopologyError
from dcf_zenoh.graph import WEIGHTS, Graph, laplacian
from dcf_zenoh.plant import Array
from dcf_zenoh.plugins import create, load
from dcf_zenoh.spec import FleetSpec


def draw(spec: FleetSpec, folder: Path) -> Graph:
    """Who hears whom.

    Args:
        spec: The fleet.
        folder: What the path of a topology in a file is relative to.

    Raises:
        PluginError: The topology cannot be loaded, or refuses its options.
        TopologyError: The links do not make a strongly connected graph on the agents.
    """
    topology = spec.topology
    links = create(load("topologies", topology.kind, folder), {"agents": spec.ids}, topology.options, "topology")
    try:
        graph = Graph.of(spec.ids, links)
    except TopologyError:
        raise
    except Exception as error:  # a generator fails only now
        raise PluginError(f"topology: {topology.kind} refused its options: {reason(error)}") from error
    _ = graph.diameter
    return graph


def weights_of(spec: FleetSpec, graph: Graph) -> Array:
    """The mixing weights of a fleet on its graph, rows and columns in order of ids.

    Raises:
        TopologyError: Metropolis or Laplacian weights on a graph that is not undirected, too large a step, or one that
            no weights use.
    """
    name = spec.topology.weights
    if name == "auto":
        name = "metropolis" if graph.undirected else "uniform"
    if name == "laplacian":
        return laplacian(graph, spec.topology.weight_step)
    if spec.topology.weight_step is not None:
        raise TopologyError(f"weight_step is an option of 'laplacian' alone, and the weights are {name!r}")
    return WEIGHTS[name](graph)
