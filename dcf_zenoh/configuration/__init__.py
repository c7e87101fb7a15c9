"""Reading of fleet files, checks, and construction of the parts of a fleet; used through `dcf_zenoh.config`."""
