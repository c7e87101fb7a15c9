"""Algorithm 1 and what surrounds it in one agent: phases of the flight, safety rules, faults of the agent itself.

Does no I/O and knows no clock: everything here asks its runner by `dcf_zenoh.requests`.
"""
