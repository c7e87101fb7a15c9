"""Text of the explanation of a closest approach."""

from collections.abc import Iterable, Iterator, Sequence

from dcf_zenoh.analysis.explanation import AgentStep, Alternative, Explanation, LinkStep, StepBefore
from dcf_zenoh.analysis.link_health import NETWORK
from dcf_zenoh.records.run import Run

_ENDS = {
    "agreed": "stopped by agreement",
    "returned": "was ended by the algorithm itself",
    "rounds": "was out of rounds",
    "budget": "was out of time",
}
_ALIKE = 0.01  # of the barrier, or m; a smaller difference between replay and run does not count


def why_lines(run: Run, found: Explanation) -> Iterator[str]:
    """Yield the text, line by line.

    Args:
        run: The run.
        found: Its explanation.
    """
    sample_time = run.fleet.time.sample_time
    one, other = found.pair
    yield f"{run.fleet.name}, {run.name}: {run.fleet.topology.kind} topology, {run.fleet.time.clock} clock"
    sample = f"at step {found.step} ({found.step * sample_time:.1f} s)"
    place = f"at {found.closest.time:.2f} s; at the samples {_value(found, found.value)} {sample}"
    yield (
        f"Closest approach: {_value(found, found.closest.value)} between agents {one} and {other}"
        f" {place if found.closest.between else f'{sample}, at the samples'}."
    )
    if found.quantity == "barrier":
        kept = "kept" if found.closest.value >= 0 else "violated: each was in the other's safety region"
        yield f"The barrier h >= 0 was {kept}."
    elif run.geometry.unknown is not None:
        yield f"Safety regions were left out: {run.geometry.unknown}."
    if not found.before:
        yield "The run begins there: no decision led to it."
        return
    if len(found.path[0]) > 2 or len(found.path[1]) > 2:
        ways = " and ".join(" → ".join(map(str, way)) for way in found.path)
        yield f"The two are no neighbours; the shortest paths between them are {ways}."
    for step in found.before:
        yield ""
        yield from _step(run, found, step)
    if found.falsified:
        yield ""
        acts = [f"{name!r} acts on {count} link{'s' * (count > 1)}" for name, count in found.falsified.items()]
        yield f"Faults of payloads: {', '.join(acts)}."
    yield ""
    yield f"{_ideal(found)}, all agents present, as many rounds as it takes, and setpoints that act as late:"
    for alternative in found.alternatives:
        yield f"  {_alternative(found, alternative)}"
    yield from _remarks(found.alternatives)
    yield ""
    yield _verdict(found)


def _step(run: Run, found: Explanation, step: StepBefore) -> Iterator[str]:
    yield f"Step {step.step} ({step.step * run.fleet.time.sample_time:.1f} s), began at {_value(found, step.value)}:"
    for link in step.between:
        yield f"  {link.sender} → {link.receiver}: {_link(link)}"
    pair = " and ".join(map(str, found.pair))
    for links, where in ((step.others, f"other links to {pair}"), (step.elsewhere, "all other links")):
        if links:
            yield f"  {where}: {_total(links)}"
    for agent in step.agents:
        yield f"  agent {agent.agent} {_end(agent, run.fleet.exchange.threshold)}"
    others = [each for each in step.absent if each.agent not in found.pair]
    for agent in others:
        yield f"  agent {agent.agent} {_end(agent, run.fleet.exchange.threshold)}"


def _link(link: LinkStep) -> str:
    text = f"{link.lost_count or 'none'} of {link.sent} messages lost"
    causes = [
        f"{len(rounds)} by {_cause(cause)} (round{'s' * (len(rounds) > 1)} {_ranges(rounds)})"
        for cause, rounds in link.lost.items()
    ]
    return f"{text}{': ' * bool(causes)}{', '.join(causes)}{_also(link.late, link.missing)}{_latency(link)}"


def _cause(name: str) -> str:
    return name if name == NETWORK else repr(name)


def _latency(link: LinkStep) -> str:
    return f"; mean latency {link.latency * 1e3:.2f} ms" if link.latency else ""


def _also(late: int, missing: int) -> str:
    text = f"; {late} late" if late else ""
    return text + (f"; {missing} round{'s' * (missing > 1)} ended without one" if missing else "")


def _total(links: Sequence[LinkStep]) -> str:
    sent, lost = sum(link.sent for link in links), sum(link.lost_count for link in links)
    late, missing = sum(link.late for link in links), sum(link.missing for link in links)
    return f"{lost or 'none'} of {sent} messages lost{_also(late, missing)}"


def _end(agent: AgentStep, threshold: float) -> str:
    if agent.absent:
        return "took no part" + (f": {agent.remark}" if agent.remark else "")
    text = f"{_ENDS.get(agent.stopped_by, agent.stopped_by)} after {agent.rounds} rounds"
    text += f", residual {agent.residual:.2g} (threshold {threshold:g})"
    text += f", and acted {agent.acted_after * 1e3:.3g} ms after measuring"
    if agent.overran:
        text += "; too late for its own setpoint"
    if agent.notes:
        text += "; noted " + ", ".join(f"{count:g} {name}" for name, count in agent.notes.items())
    return text + (f"; {agent.remark}" if agent.remark else "")


def _alternative(found: Explanation, alternative: Alternative) -> str:
    again = alternative.replay
    steps = f"step {again.first}" if again.end == again.first + 1 else f"steps {again.first} to {again.end - 1}"
    rounds = f"{again.rounds} rounds" if again.end == again.first + 1 else f"up to {again.rounds} rounds"
    how = f"{rounds}, {'agreed' if again.agreed else 'still without agreement'}"
    return (
        f"{steps} once more ({how}): {_value(found, alternative.value)} at step {again.end}"
        f" instead of {found.value:.3f}{_unit(found)}"
    )


def _remarks(alternatives: Iterable[Alternative]) -> Iterator[str]:
    free = sorted({agent for each in alternatives for agent in each.replay.free})
    if free:
        who = "agent" if len(free) == 1 else "agents"
        yield f"  Free bodies stood in for the plants of {who} {', '.join(map(str, free))}, which cannot be replayed."


def _verdict(found: Explanation) -> str:
    values = [each.value for each in found.alternatives]
    gain = max(values) - found.value
    if not found.disturbed:
        return _undisturbed(found, gain)
    if gain <= _ALIKE:
        return (
            f"Something was lost, late, absent or falsified in these steps, but {_ideal(found, 'with')} the two would"
            f" have come as close{' or closer' * (min(values) < found.value - _ALIKE)}: it is not the cause."
        )
    if found.quantity == "distance" or found.value >= 0:
        return f"{_ideal(found)} the two would have stayed further apart, by up to {gain:.3f}{_unit(found)}."
    for each in found.alternatives:
        if each.value >= 0:
            return f"{_ideal(found)} from step {each.replay.first} on, the barrier would have been kept."
    return f"{_ideal(found)} the barrier would have been violated all the same, by {gain:.3f} less."


def _ideal(found: Explanation, word: str = "With") -> str:
    return f"{word} a perfect network{' and true payloads' if found.falsified else ''}"


def _undisturbed(found: Explanation, gain: float) -> str:
    text = "Nothing was lost, late or absent in these steps"
    if gain > _ALIKE and found.took_time:
        return f"{text}. What the replay gains, it gains by time: messages take none, so there are more rounds."
    more = " What the replay gains, it gains by more rounds." if gain > _ALIKE else ""
    return f"{text}: the network is not the cause.{more}"


def _value(found: Explanation, value: float) -> str:
    return f"h = {value:.3f}" if found.quantity == "barrier" else f"distance {value:.3f} m"


def _unit(found: Explanation) -> str:
    return "" if found.quantity == "barrier" else " m"


def _ranges(numbers: Iterable[int]) -> str:
    """Return ascending numbers as text, with ranges: 3, 7–9."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}–{run[-1]}" for run in runs)
