"""Checks of the faults of agents: crashes and pauses must be within the run."""

from dcf_zenoh.configuration.checks.times import LONGEST
from dcf_zenoh.diagnostics import Diagnostics
from dcf_zenoh.spec import FleetSpec

HOW_TO_GO_ON = ", by safety.neighbour_silent.then = 'land'; 'continue' goes on"


def check_agent_faults(spec: FleetSpec, diagnostics: Diagnostics, notes: list[str]) -> list[str]:
    """Check the faults of agents.

    Returns:
        Keys of the faults that keep an agent from sending.
    """
    silencing: list[str] = []
    silent = spec.safety.neighbour_silent
    for agent, own in spec.agents.items():
        key, faults = f"agents.{agent}.faults", own.faults
        gone: dict[str, float] = {}
        if faults.crash:
            _check_begin(spec, f"{key}.crash.at", faults.crash.at, diagnostics)
            back = faults.crash.restart_after
            gone[f"{key}.crash"] = LONGEST if back is None else back
            if back is not None and back > LONGEST:
                diagnostics.add(f"{key}.crash.restart_after", f"expected at most {LONGEST:g} s, not {back:g}")
        if faults.pause:
            check_window(spec, f"{key}.pause", faults.pause, diagnostics)
            gone[f"{key}.pause"] = faults.pause[1] - faults.pause[0]
            if faults.crash and faults.crash.restart_after is None and faults.pause[0] >= faults.crash.at:
                diagnostics.add(f"{key}.pause", f"begins when the agent is dead, from {faults.crash.at:g} s on")
        if faults.slow:
            if faults.slow.during is not None:
                check_window(spec, f"{key}.slow.during", faults.slow.during, diagnostics)
            if faults.slow.factor > LONGEST:
                diagnostics.add(f"{key}.slow.factor", f"expected at most {LONGEST:g}, not {faults.slow.factor:g}")
            if spec.time.clock == "virtual" and spec.exchange.compute_time == 0:
                notes.append(f"{key}.slow: without effect on the virtual clock, as exchange.compute_time is 0")
        silencing += gone
        notes += [
            f"{each}: the run ends when agent {agent} has been silent for {silent.after:g} s{HOW_TO_GO_ON}"
            for each, lasts in gone.items()
            if silent.then == "land" and lasts > silent.after and len(spec.agents) > 1
        ]
    return silencing


def check_window(spec: FleetSpec, key: str, window: tuple[float, float], diagnostics: Diagnostics) -> None:
    """Check begin and end of a time in the run, in s."""
    begin, end = window
    if begin >= end:
        diagnostics.add(key, f"expected begin < end, not [{begin:g}, {end:g}]")
    if end > LONGEST:
        diagnostics.add(key, f"expected at most {LONGEST:g} s, not {end:g}")
    _check_begin(spec, key, begin, diagnostics)


def _check_begin(spec: FleetSpec, key: str, begin: float, diagnostics: Diagnostics) -> None:
    length = spec.steps * spec.time.sample_time
    if begin >= length:
        diagnostics.add(key, f"expected within the run, which ends at {length:g} s, not {begin:g} s")
