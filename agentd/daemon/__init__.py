"""One agent as a process: composition root, runners, reading from the network, requests of operators."""
