"""Distributed algorithms: how a problem is solved. The contract is in `algorithm`."""
