"""Checks of the times of a fleet file, and of the rounds of each mode."""

from collections.abc import Sequence
from math import floor, log10

from dcf_zenoh.diagnostics import Diagnostics, listed
from dcf_zenoh.spec import FleetSpec

LIKELY_MS = 5.0  # control periods, budgets and time-outs of as many s are likely meant in ms
LONGEST = 1e8  # s; about three years
WALL_ROUND = 2e-3  # s; about a round on the wall clock: a shorter time-out loses messages that are only late


def check_time(spec: FleetSpec, diagnostics: Diagnostics, notes: list[str]) -> None:
    """Check that times are not absurdly long, and note more rounds than there is time for."""
    rounds, sample_time = spec.exchange, spec.time.sample_time
    for key, value in {
        "time.sample_time": sample_time,
        "time.duration": spec.time.duration,
        "exchange.budget": rounds.budget,
        "exchange.round_timeout": rounds.round_timeout,
        "exchange.compute_time": rounds.compute_time,
        "safety.neighbour_silent.after": spec.safety.neighbour_silent.after,
        "zenoh.ready_timeout": spec.zenoh.ready_timeout,
        "zenoh.receive_timeout": spec.zenoh.receive_timeout,
    }.items():
        if value is not None and value > LONGEST:
            diagnostics.add(key, f"expected at most {LONGEST:g} s, not {value:g}")
    if spec.seed >= 2**63:
        diagnostics.add("seed", f"expected less than 2^63, not {spec.seed}")
    silences = {
        "safety.neighbour_silent.after": spec.safety.neighbour_silent.after,
        "controller.lost_after": spec.controller_kind.options.get("lost_after"),
    }
    flies = spec.has_plants and len(spec.agents) > 1
    for key, value in silences.items():
        if isinstance(value, int | float) and value < 2 * sample_time - 1e-9 and flies:
            notes.append(
                f"{key}: {value:g} s is less than two control periods, {2 * sample_time:g} s: a neighbour whose"
                " messages of one step are missing counts as lost"
            )
    if sample_time > spec.time.duration and spec.has_plants:
        diagnostics.add(
            "time.sample_time",
            f"expected at most time.duration = {spec.time.duration:g} s, not {sample_time:g} s{_in_ms(sample_time)}",
        )
    budget = rounds.step_budget(sample_time)
    if budget > sample_time:
        diagnostics.add(
            "exchange.budget",
            f"expected at most time.sample_time = {sample_time:g} s, not {budget:g} s{_in_ms(budget)}",
        )
    if rounds.round_timeout is not None and rounds.round_timeout > budget and rounds.mode == "synchronous":
        notes.append(
            f"exchange.round_timeout: {rounds.round_timeout:g} s is longer than the budget of a step, {budget:g} s,"
            f" so it never acts{_in_ms(rounds.round_timeout)}"
        )
        return
    if rounds.mode == "asynchronous" or rounds.round_timeout is None:
        return
    if rounds.max_rounds * rounds.round_timeout > budget * (1 + 1e-9):
        worst = rounds.max_rounds * rounds.round_timeout
        notes.append(
            f"exchange: worst case {rounds.max_rounds} x {rounds.round_timeout * 1e3:g} ms = {worst:.3f} s"
            f" > budget {budget:.3f} s: a step may end by time, not by agreement"
        )


def _in_ms(value: float) -> str:
    """Return a hint at the unit if `value`, in s, looks like a number of ms."""
    return f" (times are in s; {value:g} ms are {value / 1e3:g})" if value >= LIKELY_MS else ""


def check_activations(spec: FleetSpec, diagnostics: Diagnostics, notes: list[str]) -> None:
    """Check the activations of asynchronous mode, and note keys that have no effect in the chosen mode."""
    rounds = spec.exchange
    activations = {"exchange.period": rounds.period, "exchange.jitter": rounds.jitter or None}
    for agent, own in spec.agents.items():
        activations[f"agents.{agent}.exchange.period"] = own.exchange.period
        activations[f"agents.{agent}.exchange.jitter"] = own.exchange.jitter
    given = [key for key, value in activations.items() if value is not None]
    if rounds.mode == "synchronous":
        if given:
            notes.append(f"{listed(given)}: without effect, as exchange.mode is 'synchronous'")
        return
    waiting = {"exchange.round_timeout": rounds.round_timeout, "exchange.margin": rounds.margin}
    if idle := [key for key, value in waiting.items() if value is not None]:
        notes.append(f"{listed(idle)}: without effect, as exchange.mode is 'asynchronous': nobody waits for anybody")
    budget = rounds.step_budget(spec.time.sample_time)
    for agent in spec.ids:
        chosen = spec.activation(agent)
        period, jitter = chosen.period or 0.0, chosen.jitter or 0.0
        own_period, own_jitter = (f"agents.{agent}.exchange.{key}" for key in ("period", "jitter"))
        if period > budget * (1 + 1e-9):
            key = own_period if own_period in given else "exchange.period"
            diagnostics.add(key, f"expected at most the budget of a step, {budget:g} s, not {period:g} s")
        elif jitter >= period:
            key = next((each for each in (own_jitter, own_period) if each in given), "exchange.jitter")
            diagnostics.add(key, f"expected a jitter shorter than the period; they are {jitter:g} s and {period:g} s")


def check_timeout(spec: FleetSpec, diagnostics: Diagnostics, losers: Sequence[str]) -> None:
    """Require a time-out of rounds if messages can be lost.

    Args:
        spec: Specification of the fleet.
        diagnostics: Errors, to which one may be added.
        losers: Keys of faults that can lose messages.
    """
    rounds = spec.exchange
    if not losers or rounds.mode == "asynchronous" or rounds.round_timeout is not None:
        return
    share = rounds.step_budget(spec.time.sample_time) / rounds.max_rounds
    if spec.time.clock == "wall":
        share = max(share, WALL_ROUND)
    digit = 10.0 ** floor(log10(share))
    proposal = floor(share / digit * (1 + 1e-9)) * digit  # its first digit
    diagnostics.add(
        "exchange.round_timeout",
        f"missing; {losers[0]} can lose messages, and a round would wait for a lost one until the step's budget is"
        f" used up: set it to more than the latency of the links, such as {proposal:.0g} s",
    )
