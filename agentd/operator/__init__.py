"""The operator's side of a running fleet: find it, ask it, change its faults, land or stop it."""
