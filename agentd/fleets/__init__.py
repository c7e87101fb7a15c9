"""Fleet files that every command finds by name."""
