"""Summary of a run as a table on the screen."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from dcf_zenoh.analysis.diagnosis import Diagnosis
from dcf_zenoh.analysis.findings import Finding

_ENDS = {  # keys of `Run.endings`, in the order of the table
    "agreed": "by agreement",
    "returned": "by the algorithm itself",
    "rounds": "out of rounds",
    "budget": "out of time",
    "abstained": "abstained",
    "states": "without the states of all agents",
}


def summary_table(summary: Mapping[str, Any]) -> Table:
    """Return a summary as a table.

    Args:
        summary: Result of `Run.summary`.
    """
    table = Table(title=_title(summary), title_justify="left", show_header=False, box=box.SIMPLE_HEAD)
    table.add_column(style="bold")
    table.add_column()
    for name, text in _rows(summary):
        table.add_row(name, text)
    for name, text, style in _findings(summary):
        table.add_row(name, text, style=style)
    return table


def _title(summary: Mapping[str, Any]) -> str:
    name = summary["fleet"] if summary["run"] == summary["fleet"] else f"{summary['fleet']}, {summary['run']}"
    return f"{name}: {summary['topology']} topology, {summary['clock']} clock"


def _rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    flies = summary["plant"] != "none"
    agent_steps = sum(summary["ended_by"].values())
    model = ", model time" if summary["clock"] == "virtual" else ""
    rows = [("agents", f"{summary['agents']} ({summary['plant']})" if flies else f"{summary['agents']} without plants")]
    if flies:
        arrived = f"all, at {summary['arrival_time']:.1f} s" if summary["arrived"] else "not all"
        rows += [("arrived", arrived), ("closest", _closest(summary))]
    rows += [
        ("steps", _steps(summary, agent_steps)),
        (
            "deadlines missed",
            f"{summary['deadline_misses']} of {agent_steps}{_share(summary['deadline_misses'], agent_steps)}",
        ),
        ("steps ended", _ends(summary["ended_by"])),
        *(("" if number else "because", _cause(**each)) for number, each in enumerate(summary["diagnosis"])),
        ("rounds per step", _spread(summary["rounds_per_step"], "")),
        ("computation per step", _spread(summary["compute_ms"], " ms")),
        ("negotiation per step", _spread(summary["negotiation_ms"], " ms") + model),
        ("messages", ", ".join(f"{count} {what}" for what, count in summary["messages"].items())),
    ]
    if summary["messages"]["lost"]:
        rows.append(("messages lost", _losses(summary["lost_by"])))
    if summary["unmet"]:
        found = (f"{what} ({count} {'link' if count == 1 else 'links'})" for what, count in summary["unmet"].items())
        rows.append(("faults without effect", "; ".join(found)))
    if summary["alarms"]:
        rows.append(("safety alarms", ", ".join(f"{count} {rule}" for rule, count in summary["alarms"].items())))
    if notes := {what: count for what, count in summary["notes"].items() if count}:
        rows.append(("controllers noted", ", ".join(f"{count:g} {what}" for what, count in notes.items())))
    rows.append(("digest", summary["digest"][:16]))
    return rows


def _cause(kind: str, text: str, remedy: str) -> str:  # noqa: ARG001 - fields of `Diagnosis`
    """Return a cause, and what would change it."""
    return text + (f"; try {remedy}" if remedy else "")


def diagnosis_lines(name: str, causes: Iterable[Diagnosis]) -> list[Text]:
    """Return a line for each cause of steps that ended otherwise than by agreement in the run `name`."""
    return [Text(f"{name}: {_cause(*each)}") for each in causes]


def _findings(summary: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield name, text and style of a row for each finding; the name stands in the first of a kind."""
    before = ""
    for each in summary["findings"]:
        kind = each["kind"]
        yield "" if kind == before else kind, each["text"], _style(kind)
        before = kind


def finding_lines(name: str, findings: Iterable[Finding]) -> list[Text]:
    """Return a line in colour for each finding on the run `name`."""
    return [Text(f"{name}: {each.text}", style=_style(each.kind)) for each in findings]


def _style(kind: str) -> str:
    """Return the colour of a kind of findings."""
    return "bold red" if kind == "violation" else "yellow"


def _losses(lost_by: Mapping[str, Any]) -> str:
    """Return the numbers of messages lost by each fault, and by the network."""
    causes = [f"{count} by {fault!r}" for fault, count in lost_by["faults"].items()]
    causes += [f"{lost_by['network']} by the network"] if lost_by["network"] else []
    return ", ".join(causes)


def _closest(summary: Mapping[str, Any]) -> str:
    distance, barrier = summary["min_distance"], summary["min_barrier"]
    if distance is None:
        return "no other agent"
    safety = "" if barrier is None else f", least barrier {barrier:.3f}"
    clearance = summary["min_clearance"]
    obstacles = "" if clearance is None else f", with obstacles {clearance:.3f}"
    samples = "" if summary["between_samples"] else "; at the samples"
    return f"{distance:.3f} m{safety}{obstacles}{samples}"


def _steps(summary: Mapping[str, Any], agent_steps: int) -> str:
    steps, common = summary["steps"], summary["steps_of_all"]
    return f"{steps}{' of all agents' if steps == common else f', {common} of all agents'}, {agent_steps} agent-steps"


def _share(part: int, whole: int) -> str:
    return f" ({100 * part / whole:.1f} %)" if whole else ""


def _ends(ended_by: Mapping[str, int]) -> str:
    words = [*_ENDS, *sorted(set(ended_by) - set(_ENDS))]
    return ", ".join(f"{ended_by[word]} {_ENDS.get(word, word)}" for word in words if ended_by.get(word)) or "none"


def _spread(values: Mapping[str, float | None], unit: str) -> str:
    """Return median, 95th percentile and maximum, in three digits."""
    if values["median"] is None:
        return "none"
    median, most, maximum = (f"{values[key]:.3g}{unit}" for key in ("median", "p95", "max"))
    return f"median {median}, 95 % below {most}, at most {maximum}"
