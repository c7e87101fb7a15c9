"""The commands of `agentd` with their arguments and options."""

import argparse
from pathlib import Path
from typing import Protocol

from agentd import commands
from dcf_zenoh.plugins import GROUPS

Parser = argparse.ArgumentParser
ORACLE = "compare every decision with that of a central solver"
STRICT = "fail, with exit code 6, if there are findings, such as a violation or an agent that did not arrive"
RUN = "run directory, or name of a fleet: its newest run below runs/"


class Add(Protocol):
    """Function that adds a command to the command line."""

    def __call__(self, name: str, function: commands.Command, help: str, *parents: Parser) -> Parser:
        """Add a command; return its parser, to which its own options can be added.

        Args:
            name: Name of the command.
            function: Function to call with the parsed options; its docstring is the help text.
            help: Line in the list of commands.
            parents: Options that the command shares with other commands.
        """


def add_flights(command: Add, fleet: Parser, results: Parser) -> None:
    """Add the commands that take a fleet."""
    launch = command("launch", commands.launch, "run a fleet as one daemon per agent on this machine", fleet, results)
    run = command("run", commands.run, "run one agent of a fleet: one daemon", fleet)
    for each in (launch, run):
        each.add_argument("--yes", action="store_true", help="real bodies may take off without a key press")
    run.add_argument("--id", type=int, required=True, metavar="N", help="which agent")
    run.add_argument("--out", type=Path, metavar="DIR", help="run directory (default: runs/FLEET)")
    run.add_argument("--run", metavar="NAME", help="name of the run, the same for all its agents (default: manual)")
    run.add_argument(
        "--rejoin", action="store_true", help="the fleet is flying and this agent's daemon has died: join it again"
    )
    run.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)
    command("simulate", commands.simulate, "run a fleet in this process, in virtual time", fleet, results)
    command("preflight", commands.preflight, "connect to the bodies of a fleet and say what shape they are in", fleet)
    compare = command("compare", commands.compare, "run variants of a fleet and draw them side by side", fleet)
    compare.add_argument(
        "--vary", action="append", required=True, metavar="KEY=A,B", help="what the variants differ in; may be repeated"
    )
    compare.add_argument("--launch", action="store_true", help="daemons for every variant, on the clock of the fleet")
    compare.add_argument("--yes", action="store_true", help="real bodies may take off without a key press")
    compare.add_argument("--out", type=Path, metavar="DIR", help="for all of it (default: a new one below runs/)")
    compare.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    sweep = command("sweep", commands.sweep, "simulate variants of a fleet with many seeds, on all cores", fleet)
    sweep.add_argument("--vary", action="append", required=True, metavar="KEY=A,B", help="as in compare")
    sweep.add_argument("--seeds", type=int, default=10, metavar="N", help="how many of each variant (default: 10)")
    sweep.add_argument("--processes", type=int, metavar="N", help="how many at a time (default: one for each core)")
    sweep.add_argument("--no-oracle", action="store_true", help="do not solve the steps in one place as well")
    sweep.add_argument("--keep", action="store_true", help="keep the run directory of every run")
    sweep.add_argument("--out", type=Path, metavar="DIR", help="a new directory, or that of a sweep to go on with")
    sweep.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    check = command("check", commands.check, "check a fleet file and print it with all defaults", fleet)
    check.add_argument("--load", action="store_true", help="also run the code of plug-ins, to check their types")
    plugins = command("plugins", commands.plugins, "list all kinds that a fleet file can name, with their keys")
    plugins.add_argument("group", nargs="?", choices=GROUPS, metavar="GROUP", help=f"one of {', '.join(GROUPS)}")


def add_interventions(command: Add) -> None:
    """Add the commands that act on a running fleet."""
    fault = command("fault", commands.fault, "change the faults of a fleet that runs, show or export what was changed")
    fault.add_argument("run", metavar="RUN", help=RUN)
    fault.add_argument("--from", dest="senders", metavar="I[,J]", help="sending agents (default: all)")
    fault.add_argument("--to", dest="receivers", metavar="J[,K]", help="receiving agents (default: all)")
    fault.add_argument("words", nargs="+", metavar="WORD", help="NAME [VALUE] [KEY=VALUE ...], clear, show or export")
    for name, function, help in (
        ("land", commands.land, "land all agents of a run, and end it"),
        ("stop", commands.stop, "emergency stop: all motors of a run off at once"),
    ):
        end = command(name, function, help)
        end.add_argument("run", metavar="RUN", help=RUN)


def add_runs(command: Add, results: Parser) -> None:
    """Add the commands that take runs."""
    report = command("report", commands.report, "draw the figures of one run, or of several side by side")
    report.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    report.add_argument("--out", type=Path, metavar="DIR", help="where figures go (default: the first run)")
    report.add_argument("--oracle", action="store_true", help=ORACLE)
    report.add_argument("--strict", action="store_true", help=STRICT)
    report.add_argument("--animate", action="store_true", help="also draw the flight as a GIF")
    export = command("export", commands.export, "write a run as CSV, NPZ or MAT")
    export.add_argument("run", type=Path, metavar="RUN")
    export.add_argument("--to", required=True, metavar="FORMAT", help="csv, npz or mat")
    export.add_argument("--out", type=Path, metavar="FILE", help="default: RUN.FORMAT in the working directory")
    rerun = command("rerun", commands.rerun, "repeat a run and compare", results)
    rerun.add_argument("run", type=Path, metavar="RUN")
    diff = command("diff", commands.diff, "compare two runs")
    diff.add_argument("a", type=Path, metavar="RUN")
    diff.add_argument("b", type=Path, metavar="RUN")
    diff.add_argument(
        "--tolerance", type=float, default=0.0, metavar="X", help="largest deviation that is no difference"
    )
    links = command("links", commands.links, "say how well each link of a run did, and export it for a replay")
    links.add_argument("run", type=Path, metavar="RUN")
    links.add_argument("--json", action="store_true", help="print one JSON object, times in s")
    links.add_argument("--export", type=Path, metavar="FILE", help="write a profile, and print what replays it")
    why = command("why", commands.why, "explain the closest approach of a run, and replay it without faults")
    why.add_argument("run", type=Path, metavar="RUN")


def add_emulator(command: Add) -> None:
    """Add the command for emulated Crazyflies."""
    drones = command("emulate-crazyflie", commands.emulate_crazyflie, "software Crazyflies that cflib connects to")
    drones.add_argument("--n", type=int, default=4, metavar="N", help="how many (default: 4)")
    drones.add_argument("--fleet", metavar="FLEET", help="instead: one per agent of a fleet, at its start and URI")
    drones.add_argument("--plant", metavar="NAME", help="plant whose URIs are meant: one of [plants]")
    drones.add_argument("--port", type=int, default=19850, metavar="P", help="of the first drone (default: 19850)")
    drones.add_argument("--tcp", action="store_true", help="TCP with frames of CPX instead of UDP")
    drones.add_argument("--truth", type=Path, metavar="DIR", help="write what each drone really does to DIR")
    drones.add_argument("--latency", type=float, default=0.005, metavar="S", help="of the radio, s (default: 0.005)")
    drones.add_argument("--tail", type=float, default=0.0, metavar="S", help="mean of what comes on top of it, s")
    drones.add_argument("--silences", type=float, default=0.0, metavar="X", help="of 0.3 s, mean number per minute")
    drones.add_argument("--loss", type=float, default=0.0, metavar="P", help="of packets, once connected, 0 .. 1")
    drones.add_argument("--sensing", choices=["lighthouse", "perfect"], default="lighthouse")
    drones.add_argument("--parameters", default="forster2015", metavar="NAME", help="of the body's model")
    drones.add_argument("--seed", type=int, default=0, metavar="N")
    drones.add_argument("--until-stdin-closes", action="store_true", help="end when standard input ends")


def fleet_options() -> Parser:
    """Return the options of all commands that load a fleet."""
    options = argparse.ArgumentParser(add_help=False)
    options.add_argument("fleet", metavar="FLEET", help="fleet file, or name of a built-in fleet")
    group = options.add_argument_group("instead of what the fleet file says")
    group.add_argument("--seed", type=int, metavar="N")
    group.add_argument("--clock", choices=["wall", "virtual"])
    group.add_argument("--plant", metavar="NAME", help="plant of every agent: one of [plants], or a kind")
    group.add_argument("--algorithm", metavar="NAME", help="one of [algorithms], or a kind")
    group.add_argument("--topology", metavar="KIND")
    group.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="any key, such as exchange.max_rounds=40"
    )
    return options


def result_options() -> Parser:
    """Return the options of all commands that report a run."""
    options = argparse.ArgumentParser(add_help=False)
    options.add_argument("--out", type=Path, metavar="DIR", help="run directory (default: a new one below runs/)")
    options.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    options.add_argument("--no-report", action="store_true", help="draw no figures at the end")
    options.add_argument("--animate", action="store_true", help="also draw the flight as a GIF")
    options.add_argument("--oracle", action="store_true", help=ORACLE)
    options.add_argument("--strict", action="store_true", help=STRICT)
    return options
