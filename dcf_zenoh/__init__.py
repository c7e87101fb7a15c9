"""dcf-zenoh: write a distributed control algorithm once; run it in one process, as daemons, or on robots."""

from dcf_zenoh.algorithms.algorithm import Inbox, Me, PerNeighbour, Result
from dcf_zenoh.plant import Plant, Setpoint, State
from dcf_zenoh.records.run import Run
from dcf_zenoh.simulation import simulate

__all__ = ["Inbox", "Me", "PerNeighbour", "Plant", "Result", "Run", "Setpoint", "State", "simulate"]
