"""Communication faults: what a network does to messages, as data, on each directed link."""
