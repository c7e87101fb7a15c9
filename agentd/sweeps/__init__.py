"""Variants of a fleet, run one after the other and compared, or simulated in parallel with many seeds."""
