"""Plants: the bodies of agents."""
