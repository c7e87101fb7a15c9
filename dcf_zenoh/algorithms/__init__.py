"""Distributed algorithms, one per file. `algorithm` has the contract, `needs` the declaration of preconditions."""
