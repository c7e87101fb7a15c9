"""The log of an agent and of a run: its writer, its schema, and what is read from it."""
