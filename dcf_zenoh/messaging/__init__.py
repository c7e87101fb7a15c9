"""What agents send one another, and how it travels."""
