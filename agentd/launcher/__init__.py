"""The launcher: daemons as child processes, terminal, run directory, preflight, emulated drones."""
