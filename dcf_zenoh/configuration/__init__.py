"""What stands between a fleet file and `dcf_zenoh.config.load`."""
