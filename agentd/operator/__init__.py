"""The operator's commands on a running fleet: find it, query its agents, change their faults, land or stop them."""
