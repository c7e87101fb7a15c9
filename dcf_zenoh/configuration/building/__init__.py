"""From a specification to graphs, problems, plants and chains of faults."""
