"""The built-in fleet files, which every command finds by name."""
