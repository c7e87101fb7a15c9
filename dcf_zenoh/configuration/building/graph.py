"""The communication graph of a fleet, made by its topology, and its mixing weights."""

from pathlib import Path

from dcf_zenoh.diagnostics import reason
from dcf_zenoh.errors import PluginError, TopologyError
from dcf_zenoh.graph import WEIGHTS, Graph, laplacian
from dcf_zenoh.plant import Array
from dcf_zenoh.plugins import create, load
from dcf_zenoh.spec import FleetSpec


def draw(spec: FleetSpec, folder: Path) -> Graph:
    """Return the communication graph of a fleet.

    Args:
        spec: Specification of the fleet.
        folder: Folder that the path of a topology is relative to.

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
    except Exception as error:  # a generator runs, and fails, only now
        raise PluginError(f"topology: {topology.kind} refused its options: {reason(error)}") from error
    _ = graph.diameter
    return graph


def weights_of(spec: FleetSpec, graph: Graph) -> Array:
    """Return the mixing weights of a fleet on its graph, shape (N, N), rows and columns in order of ids.

    Raises:
        TopologyError: The graph of Metropolis or Laplacian weights is not undirected, the weight step is too large, or
            it is given with weights that do not use it.
    """
    name = spec.topology.weights
    if name == "auto":
        name = "metropolis" if graph.undirected else "uniform"
    if name == "laplacian":
        return laplacian(graph, spec.topology.weight_step)
    if spec.topology.weight_step is not None:
        raise TopologyError(f"weight_step is an option of 'laplacian' alone, and the weights are {name!r}")
    return WEIGHTS[name](graph)
