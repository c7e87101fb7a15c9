"""The launcher: one daemon per agent as a child process, its terminal and progress; preflight; emulated drones."""
