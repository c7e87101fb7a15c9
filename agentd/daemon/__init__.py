"""One agent as a process: composition root, runners, inbound messages, operators' requests."""
