"""dcf-zenoh: write a distributed control algorithm once; run it in one process, as daemons, or on robots."""

from typing import TYPE_CHECKING

from dcf_zenoh.algorithms.algorithm import Inbox, Me, PerNeighbour, Result
from dcf_zenoh.plant import Plant, Setpoint, State
from dcf_zenoh.records.run import Run
from dcf_zenoh.simulation import simulate

__all__ = ["Inbox", "Me", "PerNeighbour", "Plant", "Result", "Run", "Setpoint", "State", "simulate"]

if TYPE_CHECKING:
    __version__: str
else:

    def __getattr__(name: str) -> str:
        """Look up the version of the installed distribution when it is first asked for, which takes about 2 ms."""
        if name != "__version__":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib.metadata import version  # noqa: PLC0415

        return version("dcf-zenoh")
