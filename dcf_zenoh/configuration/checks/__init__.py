"""What a fleet file must satisfy beyond the types of its keys, one file per kind of check."""
