"""Contract checks for algorithms, problems, topologies, plants and faults, and a fleet in a plain loop.

Each kind, built-in or third-party, must pass the check of its family. The loop runs algorithms and controllers in
lockstep, without messages and clock.
"""

from dcf_zenoh.testing.algorithm import check_algorithm
from dcf_zenoh.testing.fault import check_fault
from dcf_zenoh.testing.lockstep import Delay, converse, fleet_of, in_time, lockstep, lossy
from dcf_zenoh.testing.plant import check_plant
from dcf_zenoh.testing.problem import check_problem
from dcf_zenoh.testing.topology import check_topology

__all__ = [
    "Delay",
    "check_algorithm",
    "check_fault",
    "check_plant",
    "check_problem",
    "check_topology",
    "converse",
    "fleet_of",
    "in_time",
    "lockstep",
    "lossy",
]
