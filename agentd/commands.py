"""The commands of `agentd`, one function each. Their docstrings are the help texts.

Each command imports what it alone needs when it runs, so that every command starts fast.
"""

import json
import sys
from argparse import Namespace
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeAlias

from agentd.endpoints import default_endpoints
from agentd.run_and_report import (
    check_findings,
    consult_oracle,
    launch_and_report,
    load_fleet,
    print_note,
    print_oracles,
    print_wide,
    read_run,
    simulate_and_report,
)
from agentd.run_directory import new_run_folder, read_run_json
from dcf_zenoh.config import freeze, load, to_toml
from dcf_zenoh.errors import ConfigurationError, DcfError, RecordingError
from dcf_zenoh.plugins import GROUPS
from dcf_zenoh.records.log_writer import check_unused
from dcf_zenoh.records.run import Run

Command: TypeAlias = Callable[[Namespace], int]


def launch(options: Namespace) -> int:
    """Run FLEET as one daemon per agent on this machine, linked by Zenoh over the loopback interface.

    Shows how far each agent is, ends with a summary and figures, and leaves everything in a run directory. When an
    agent fails the others end too (or hold, if the fleet file says so) and the exit code is not 0. Ctrl-C ends all.
    """
    fleet = load_fleet(options)
    launch_and_report(fleet, new_run_folder(fleet.spec, options.out), options)
    return 0


def run(options: Namespace) -> int:
    """Run one agent of FLEET: one daemon, on the machine that carries the agent.

    Start one per agent, on one machine or on several, each with the same fleet file. They meet at the endpoints that
    the fleet file gives (agents.N.endpoint), by default tcp/127.0.0.1:7450+N, and start together.

    If a daemon has died while the others fly on (safety.neighbour_silent.then = "continue"), start it again with
    --rejoin: `agentd run RUN/fleet.toml --id N --out RUN --rejoin`. It takes part from the next control step; a
    simulated plant goes on from its last recorded state.
    """
    from agentd.daemon.daemon import Assignment, run_agent  # noqa: PLC0415
    from agentd.daemon.output import claim_stdout, detach_output  # noqa: PLC0415
    from agentd.operator_file import OperatorFile  # noqa: PLC0415
    from dcf_zenoh.messaging.address import Address, prefix_of  # noqa: PLC0415

    status = claim_stdout() if options.supervised else None
    fleet = load_fleet(options, unused=not options.supervised)  # the launcher has checked unused tables
    if options.id not in fleet.spec.agents:
        raise ConfigurationError(
            f"--id {options.id}: there is no such agent; agents are {list(fleet.spec.ids)}", fleet.source
        )
    folder: Path = options.out or Path("runs") / fleet.spec.name
    launched = read_run_json(folder)
    endpoints = {int(i): str(endpoint) for i, endpoint in launched.get("endpoints", {}).items()}
    if options.rejoin and "ended" in launched:
        raise RecordingError(f"{folder}: --rejoin: this run ended at {launched['ended']}")
    if options.rejoin and fleet.spec.time.clock == "virtual":
        raise ConfigurationError("--rejoin: only on the wall clock; a run in virtual time can be repeated instead")
    if not (options.supervised or options.rejoin):
        check_unused(folder, options.id)
        fleet = freeze(fleet, folder)
    task = Assignment(
        agent=options.id,
        run=options.run or launched.get("run", "manual"),
        folder=folder,
        endpoints=endpoints or default_endpoints(fleet.spec),
        rejoin=options.rejoin,
        status=status,
        agreed=options.yes,
    )
    if not options.supervised:
        endpoints_of_all, settings = tuple(task.endpoints.values()), fleet.spec.zenoh.settings
        address = Address(prefix_of(fleet.spec.name, task.run), "", endpoints_of_all, settings)
        OperatorFile.of(fleet.spec.name, fleet.spec.ids, address).write(folder)
    detach_output()
    try:
        run_agent(fleet, task)
    except DcfError as error:
        if status is not None:  # standard error is a file, whose disk may be full
            with suppress(OSError):
                status.write(json.dumps({"agent": task.agent, "error": str(error).splitlines()[-1]}))
        raise
    return 0


def simulate(options: Namespace) -> int:
    """Run FLEET in this process, in virtual time whatever clock it names: as fast as can be, no Zenoh, one thread.

    The result depends on the fleet file and its seed only; `launch --clock virtual` gives the same bits.
    """
    if options.clock == "wall":
        raise ConfigurationError("--clock wall: simulate runs in virtual time; agentd launch knows the wall clock")
    options.clock = "virtual"
    fleet = load_fleet(options)
    simulate_and_report(fleet, new_run_folder(fleet.spec, options.out), options)
    return 0


def check(options: Namespace) -> int:
    """Check FLEET and print it with all defaults filled in: what a run would use.

    All problems are reported at once. The code of plug-ins that are not part of dcf-zenoh is not run, unless --load
    is given: their files are read, not executed. With --load the parts of all agents are built, so that what their
    constructors refuse is told. A built-in problem that is solved once is solved in one place, and a
    note says if it has no solution, or if exchange.threshold is too large for its size.
    """
    from dcf_zenoh.analysis.one_off import note_on_problem, try_out  # noqa: PLC0415 - imports scipy

    fleet = load_fleet(options, run_plugins=options.load)
    if options.load:
        try_out(fleet)
    if note := note_on_problem(fleet):
        print_note(note)
    print(to_toml(fleet.spec), end="")
    return 0


def plugins(options: Namespace) -> int:
    """List all kinds that a fleet file can name, built in or installed, with the keys that each accepts.

    A kind may also be 'package.module:Name' or './file.py:Name': the keyword-only arguments of its constructor are
    its keys.
    """
    from agentd.plugin_list import catalogue  # noqa: PLC0415

    for line in catalogue([options.group] if options.group else GROUPS):
        print(line)
    return 0


def report(options: Namespace) -> int:
    """Draw the figures of one run, or of several side by side (PNG, PDF): paths, times, separation, links, and more.

    With --oracle the problem of every step is solved once more, in one place and to the end, from the recorded states;
    printed and drawn is how far each agent's decision was from that, by how much all of them together violated a
    constraint, and the residual at which the rounds were stopped.
    """
    from rich.console import Console  # noqa: PLC0415

    from agentd.results.report import write_oracle, write_report  # noqa: PLC0415
    from agentd.results.summary import diagnosis_lines, finding_lines  # noqa: PLC0415

    runs, folder = [Run.read(each) for each in options.runs], options.out or options.runs[0]
    written = write_report(runs, folder, animate=options.animate)
    if options.oracle:
        oracles = consult_oracle(runs)
        written += write_oracle(runs, oracles, folder) if oracles else []
        print_oracles(runs, oracles)
    for path in written:
        print(path)
    for run in runs:
        for line in [*diagnosis_lines(run.name, run.diagnosis), *finding_lines(run.name, run.findings)]:
            Console().print(line, soft_wrap=True)
    check_findings(runs, options)
    return 0


def export(options: Namespace) -> int:
    """Write the log of RUN for other tools: csv (one row per agent and step), npz (NumPy) or mat (MATLAB).

    Of a run with log.rounds = true the rounds are exported too: of csv in a second file, OUT_rounds.csv.
    """
    from agentd.results.export import export as export_run  # noqa: PLC0415

    print(export_run(Run.read(options.run), options.to, options.out))
    return 0


def fault(options: Namespace) -> int:
    """Change the faults of a fleet that runs on the wall clock, on the links --from some agents --to others.

    What follows the options is a fault as in [faults] of a fleet file: its name, and a value or keys with values.

      agentd fault RUN --from 1 --to 2 loss 0.3
      agentd fault RUN latency mean=0.03 distribution=normal std=0.01
      agentd fault RUN partition '[[1,2],[3,4]]'
      agentd fault RUN --to 2 loss off         no loss there, whatever the fleet file says
      agentd fault RUN clear                   end what was changed: all is as in the fleet file again
      agentd fault RUN show                    what acts on each link, and where it comes from
      agentd fault RUN export                  what was changed, as rules for a fleet file, also after the run

    A fault of one's own can be used if the fleet file names it: a fleet loads no other code while it runs. Each change
    is in the log of the agents that it is for, with the time from which it acts. The exit code is 1 if an agent does
    not answer or refuses.
    """
    from agentd.operator.change_faults import fault as change_fault  # noqa: PLC0415 - imports Zenoh

    return change_fault(options.run, options.senders, options.receivers, options.words)


def preflight(options: Namespace) -> int:
    """Connect to the bodies of FLEET and say what shape they are in. Nothing moves.

    For Crazyflies: battery, link quality, base stations, variance of the estimate, heading, distance from the start.
    The exit code is 1 if one of them could not fly.
    """
    from agentd.launcher.preflight import inspect, inspection_table  # noqa: PLC0415

    options.clock = options.clock or "wall"
    fleet = load_fleet(options)
    inspections = inspect(fleet)
    print_wide(options.output, inspection_table(fleet.spec.name, inspections))
    problems = [line for each in inspections for line in each.problems]
    for line in problems:
        print(f"agentd: {line}", file=sys.stderr)
    return 1 if problems else 0


def land(options: Namespace) -> int:
    """Land all agents of RUN where they are, and end the run. They answer when they have heard it.

    In the terminal of `agentd launch` the key l does the same.
    """
    from agentd.operator.land_stop import end_flight  # noqa: PLC0415 - imports Zenoh

    return end_flight(options.run, "land")


def stop(options: Namespace) -> int:
    """Emergency stop: all motors of RUN off at once, wherever the bodies are. They fall.

    It does not go through the control loop, so it also works where an algorithm hangs; such an agent cannot answer.
    In the terminal of `agentd launch` the key x does the same.
    """
    from agentd.operator.land_stop import end_flight  # noqa: PLC0415 - imports Zenoh

    return end_flight(options.run, "stop")


def rerun(options: Namespace) -> int:
    """Repeat RUN from what its directory holds (fleet file, plug-in files), and compare the two.

    A run in virtual time is repeated in the simulator and must be identical; one on the wall clock is launched again
    and may differ. The exit code is 1 if a run in virtual time differs.
    """
    from dcf_zenoh.analysis.comparison import compare  # noqa: PLC0415

    first = Run.read(options.run)
    fleet = load(options.run / "fleet.toml")
    folder = new_run_folder(fleet.spec, options.out)
    virtual = fleet.spec.time.clock == "virtual"
    (simulate_and_report if virtual else launch_and_report)(fleet, folder, options)
    difference = compare(first, Run.read(folder))
    print(difference, file=sys.stderr)
    return 1 if virtual and not difference.identical else 0


def diff(options: Namespace) -> int:
    """Compare two runs: prints 'identical', or where they first differ and the largest deviations.

    Of runs in virtual time the messages that links lost or delayed are compared too.
    """
    from dcf_zenoh.analysis.comparison import compare  # noqa: PLC0415

    difference = compare(Run.read(options.a), Run.read(options.b), tolerance=options.tolerance)
    print(difference)
    return 0 if difference.identical else 1


def compare(options: Namespace) -> int:
    """Run FLEET once for every variant, and draw the variants side by side: paths, times, rounds; and a table.

    --vary takes plant, algorithm, topology, seed or clock, as the options of these names do, or any key of a fleet
    file; several --vary make all combinations. What varies wins over all other options.

      agentd compare position_swap --vary plant=point,twin
      agentd compare position_swap_lossy --vary faults.loss=0.1,0.3 --vary seed=1,2,3

    A variant is simulated, in virtual time, unless its clock is said to be the wall clock (--clock, or --vary clock) or
    a plant of it is real: then it is launched as daemons in real time. With --launch all are launched, on the clock of
    the fleet.

    The table, which is also in comparison.csv: when all had arrived; overshoot: how far an agent was beyond its target,
    at most, along the line from its start; least distance and barrier value; for how long the barrier value was
    negative, and how often; RMS distance from where the plan of the step before said that a body would be; rounds;
    negotiation; deadlines missed. Distances and barrier values count between the samples too, where the paths of all
    bodies are known, as those of simulated ones are; otherwise a * says that they are those at the samples. The exit
    code is 1 if a variant failed; the others run all the same.
    """
    from agentd.sweeps.compare import compare_variants  # noqa: PLC0415

    return compare_variants(options)


def sweep(options: Namespace) -> int:
    """Simulate every variant of FLEET with many seeds, on all cores; a table of all runs, and a figure.

    --vary as in `agentd compare`. Seeds count from that of the fleet on.

      agentd sweep position_swap_lossy --vary faults.loss=0,0.05,0.2,0.5 --vary algorithm=trades,robust --seeds 20

    What is finished is kept: an interrupted sweep goes on with the same command and --out, and comes to the same
    table. sweep.csv has a row for every run; where the problem allows it, with the distance of the decisions to those
    of a central solver. The figure shows medians over the seeds, and quartiles, over the first quantity that is a
    number. The exit code is 1 if a run failed; the others run all the same.
    """
    from agentd.sweeps.sweep import sweep_variants  # noqa: PLC0415

    return sweep_variants(options)


def links(options: Namespace) -> int:
    """Print how well each link of RUN did: messages, losses and by what, latency, longest gap, clock offset.

    Recorded is what came over links with faults, and on the wall clock over all links; other links in virtual time
    lose and delay nothing, and their messages are only counted. On the wall clock a message is there when the
    receiver's loop has read it, so latencies include waiting for the loop; those of messages that the loop found when
    it woke up for a control step are left out. Between machines they are corrected by the clock offset that was
    measured when the two agents met, where that exceeds its error; both are printed.

    'lost by the network' means that numbers are missing between others. 'in a row' is the mean number of messages
    lost one after the other, 'missing' counts rounds that ended without their message, 'longest gap' is the longest
    time without a message, from the begin of the receiver's first step to the end of its last; between two control
    steps there is always one.

    With --export the measured latencies go into FILE, a profile, and the lines that make the links of a fleet do the
    same are all that is printed: record a real network, replay it, in a fleet file without faults of links:
      agentd links RUN --export lab.json >> my_fleet.toml
    Each link gets the latency and the loss that were recorded of it, by rules for all links only where they are for
    all links of the run. One of which nothing came is exported as loss = 1.0, one of which nothing was recorded not at
    all.
    """
    from agentd.results.link_rules import export_links  # noqa: PLC0415
    from agentd.results.link_table import links_object, links_table, remark, title  # noqa: PLC0415
    from dcf_zenoh.analysis.link_health import link_health  # noqa: PLC0415

    recorded = read_run(options.run)
    health = link_health(recorded)
    lines = "" if options.export is None else export_links(recorded, health, options.export)
    if options.json:
        print(json.dumps(links_object(recorded, health)), file=options.output)
    elif lines:
        print(lines, end="", file=options.output)
    else:
        print_wide(options.output, title(recorded, health), links_table(health), remark(recorded, health))
    return 0


def why(options: Namespace) -> int:
    """Explain the closest approach of RUN: what the network had to do with it.

    Names the step and the pair of agents with the smallest barrier value (or distance, where there is no safety
    region), and of the two steps that led there: what was lost or late on the links between the two (those of the
    shortest path where they are no neighbours) and on all others to them, who was absent, how the rounds ended and
    with which residual. Then the last of these steps is computed once more from the recorded states, without any
    fault and with as many rounds as it takes, and what would have come of it is printed beside what did.
    """
    from agentd.operator.fault_history import changes_of  # noqa: PLC0415
    from agentd.results.explanation_text import why_lines  # noqa: PLC0415
    from dcf_zenoh.analysis.explanation import explain  # noqa: PLC0415

    recorded = read_run(options.run)
    for line in why_lines(recorded, explain(recorded, changes_of(recorded))):
        print(line, file=options.output)
    return 0


def emulate_crazyflie(options: Namespace) -> int:
    """Be software Crazyflies, each at a port of its own, that cflib connects to and flies as if they were real.

    Each prints a line ``ready NUMBER URI``. While they run, lines on standard input make trouble, each is answered:

      1 battery 3.1          volts              2 silence 0.3      nothing gets through, s
      1 kill-link            restore-link       all loss 0.02      of packets
      3 refuse-arm on        off                3 tumble on        upside down
      2 variance 0.5         m^2, or off        2 freeze-estimate on
      4 base-stations 0      that it sees       4 drift 0.3 0.0    carried along, m/s
      1 deck-silent on       off                3 auto-arm on      off
      1 place 0.5 0.0 90     m, m, deg          1 restart          off and on again
      1 state                                   quit
    """
    from agentd.launcher.emulate import emulate  # noqa: PLC0415 - imports numba

    return emulate(options)
