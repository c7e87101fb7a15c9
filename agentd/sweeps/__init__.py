"""Variants of a fleet run one after another or in parallel, and compared."""
