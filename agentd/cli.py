"""The command line: what `agentd` understands, and how it ends (`agentd.exit_codes`)."""

import argparse
import logging
import sys
import traceback
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path

from agentd import commands, exit_codes
from dcf_zenoh.errors import AlgorithmError, DcfError, FaultError, PlantError
from dcf_zenoh.plugins import GROUPS

DESCRIPTION = """\
Run fleets of agents that compute and control together: in one process (simulate), as one daemon per agent on this
machine (launch), or one by one on several machines (run)."""

EPILOG = """\
FLEET is a fleet file (TOML) or the name of a built-in fleet; RUN is the directory of a run.

  agentd simulate position_swap               the whole fleet in this process, in virtual time
  agentd launch position_swap                 four daemons over Zenoh, on the wall clock
  agentd launch position_swap --clock virtual the same bits as simulate, over Zenoh
  agentd fault RUN --from 1 --to 2 loss 0.3   change a fleet while it runs
  agentd compare position_swap --vary plant=point,twin
  agentd check my_fleet.toml --set exchange.max_rounds=40
  agentd COMMAND --help                       what a command does, and all its options"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; its exit code."""
    options = _parser().parse_args(arguments)
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    options.output = sys.stdout
    aside = sys.stderr if getattr(options, "json", False) else sys.stdout  # for what plug-ins print
    try:
        with redirect_stdout(aside):
            code: int = options.command(options)
        return code
    except DcfError as error:
        _complain(error)
        return exit_codes.of(error)
    except KeyboardInterrupt:
        print("agentd: interrupted", file=sys.stderr)
        return exit_codes.CTRL_C
    except BrokenPipeError:  # whoever read our output has had enough
        sys.stderr.close()
        return exit_codes.FAILED


def _complain(error: DcfError) -> None:
    """One line per problem; before it, the traceback of an exception in the user's own code."""
    if isinstance(error, AlgorithmError | FaultError | PlantError) and not isinstance(error.__cause__, DcfError | None):
        traceback.print_exception(error.__cause__)
    for line in str(error).splitlines():
        print(f"agentd: {line}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="agentd", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def command(
        name: str, function: commands.Command, help: str, *parents: argparse.ArgumentParser
    ) -> argparse.ArgumentParser:
        text = (function.__doc__ or help).replace("\n    ", "\n")
        sub = subparsers.add_parser(
            name, help=help, description=text, parents=parents, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        sub.set_defaults(command=function)
        return sub

    fleet, results = _fleet_options(), _result_options()
    command("launch", commands.launch, "run a fleet as one daemon per agent on this machine", fleet, results)
    run = command("run", commands.run, "run one agent of a fleet: one daemon", fleet)
    run.add_argument("--id", type=int, required=True, metavar="N", help="which agent")
    run.add_argument("--out", type=Path, metavar="DIR", help="run directory (default: runs/FLEET)")
    run.add_argument("--run", metavar="NAME", help="name of the run, the same for all its agents (default: manual)")
    run.add_argument(
        "--rejoin", action="store_true", help="the fleet is flying and this agent's daemon has died: join it again"
    )
    run.add_argument("--supervised", action="store_true", help=argparse.SUPPRESS)
    command("simulate", commands.simulate, "run a fleet in this process, in virtual time", fleet, results)
    check = command("check", commands.check, "check a fleet file and print it with all defaults", fleet)
    check.add_argument("--load", action="store_true", help="also run the code of plug-ins, to check their types")
    plugins = command("plugins", commands.plugins, "list all kinds that a fleet file can name, with their keys")
    plugins.add_argument("group", nargs="?", choices=GROUPS, metavar="GROUP", help=f"one of {', '.join(GROUPS)}")
    report = command("report", commands.report, "draw the figures of one run, or of several side by side")
    report.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    report.add_argument("--out", type=Path, metavar="DIR", help="where figures go (default: the first run)")
    report.add_argument("--animate", action="store_true", help="also draw the flight as a GIF")
    export = command("export", commands.export, "write a run as CSV, NPZ or MAT")
    export.add_argument("run", type=Path, metavar="RUN")
    export.add_argument("--to", required=True, metavar="FORMAT", help="csv, npz or mat")
    export.add_argument("--out", type=Path, metavar="FILE", help="default: RUN.FORMAT in the working directory")
    fault = command("fault", commands.fault, "change the faults of a fleet that runs, show or export what was changed")
    fault.add_argument("run", metavar="RUN", help="run directory, or name of a fleet: its newest run below runs/")
    fault.add_argument("--from", dest="senders", metavar="I[,J]", help="sending agents (default: all)")
    fault.add_argument("--to", dest="receivers", metavar="J[,K]", help="receiving agents (default: all)")
    fault.add_argument("words", nargs="+", metavar="WORD", help="NAME [VALUE] [KEY=VALUE ...], clear, show or export")
    rerun = command("rerun", commands.rerun, "repeat a run and compare", results)
    rerun.add_argument("run", type=Path, metavar="RUN")
    diff = command("diff", commands.diff, "compare two runs")
    diff.add_argument("a", type=Path, metavar="RUN")
    diff.add_argument("b", type=Path, metavar="RUN")
    diff.add_argument(
        "--tolerance", type=float, default=0.0, metavar="X", help="largest deviation that is no difference"
    )
    compare = command("compare", commands.compare, "run variants of a fleet and draw them side by side", fleet)
    compare.add_argument(
        "--vary", action="append", required=True, metavar="KEY=A,B", help="what the variants differ in; may be repeated"
    )
    compare.add_argument("--launch", action="store_true", help="daemons for every variant, on the clock of the fleet")
    compare.add_argument("--out", type=Path, metavar="DIR", help="for all of it (default: a new one below runs/)")
    compare.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    links = command("links", commands.links, "say how well each link of a run did, and export it for a replay")
    links.add_argument("run", type=Path, metavar="RUN")
    links.add_argument("--json", action="store_true", help="print one JSON object, times in s")
    links.add_argument("--export", type=Path, metavar="FILE", help="write a profile, and print what replays it")
    why = command("why", commands.why, "explain the closest approach of a run, and replay it without faults")
    why.add_argument("run", type=Path, metavar="RUN")
    return parser


def _fleet_options() -> argparse.ArgumentParser:
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


def _result_options() -> argparse.ArgumentParser:
    options = argparse.ArgumentParser(add_help=False)
    options.add_argument("--out", type=Path, metavar="DIR", help="run directory (default: a new one below runs/)")
    options.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    options.add_argument("--no-report", action="store_true", help="draw no figures at the end")
    options.add_argument("--animate", action="store_true", help="also draw the flight as a GIF")
    return options
