"""Checks of a fleet file beyond the types of its keys, one file per kind of check."""
