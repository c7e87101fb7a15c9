"""Algorithm 1 and its surroundings in one agent: phases of the flight, safety rules, faults of the agent itself.

No I/O and no clock in here: all of that is requested from a runner (`dcf_zenoh.requests`).
"""
