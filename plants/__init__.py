"""Plants: bodies of agents, simulated and real."""
