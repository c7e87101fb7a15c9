"""dcf-zenoh: write a distributed control algorithm once; run it in one process, as daemons, or on robots."""

from typing import TYPE_CHECKING

__all__ = ["Inbox", "Me", "PerNeighbour", "Plant", "Result", "Run", "Setpoint", "State", "simulate"]

if TYPE_CHECKING:
    from dcf_zenoh.algorithms.algorithm import Inbox, Me, PerNeighbour, Result
    from dcf_zenoh.plant import Plant, Setpoint, State
    from dcf_zenoh.records.run import Run
    from dcf_zenoh.simulation import simulate

    __version__: str
else:
    _MODULES = {
        "dcf_zenoh.algorithms.algorithm": ("Inbox", "Me", "PerNeighbour", "Result"),
        "dcf_zenoh.plant": ("Plant", "Setpoint", "State"),
        "dcf_zenoh.records.run": ("Run",),
        "dcf_zenoh.simulation": ("simulate",),
    }

    def __getattr__(name: str) -> object:
        """Import what is asked for when it is asked for: an emergency stop must not wait for numpy."""
        if name == "__version__":
            from importlib.metadata import version  # noqa: PLC0415

            return version("dcf-zenoh")
        for module, names in _MODULES.items():
            if name in names:
                from importlib import import_module  # noqa: PLC0415

                return getattr(import_module(module), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
