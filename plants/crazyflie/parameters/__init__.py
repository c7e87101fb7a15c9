"""Parameters of vehicles: one TOML file each, every number with its source."""
