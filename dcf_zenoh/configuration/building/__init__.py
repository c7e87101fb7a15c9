"""Construction of graphs, problems, plants and fault chains from a specification."""
