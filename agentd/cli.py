"""The command line: parses the arguments, runs the command, turns errors into messages and exit codes."""

import argparse
import codecs
import io
import logging
import sys
import traceback
from collections.abc import Sequence
from contextlib import redirect_stdout
from typing import Any

import dcf_zenoh
from agentd import commands, exit_codes
from agentd.options import add_emulator, add_flights, add_interventions, add_runs, fleet_options, result_options
from dcf_zenoh.errors import AlgorithmError, DcfError, FaultError, PlantError

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

_SIGNS = {
    "≥": ">=", "≤": "<=", "→": "->", "←": "<-", "²": "^2", "³": "^3", "µ": "u", "μ": "u", "×": "x", "·": "*",
    "°": "deg", "–": "-", "—": "-", "−": "-", "…": "...", "±": "+-", "∞": "inf", "─": "-", "━": "-", "│": "|", "┃": "|",
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    _never_fail_to_print()
    options = _parser().parse_args(arguments)
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    options.output = sys.stdout
    plugin_output = sys.stderr if getattr(options, "json", False) else sys.stdout
    try:
        with redirect_stdout(plugin_output):
            code: int = options.command(options)
        return code
    except DcfError as error:
        _print_error(error)
        return exit_codes.of(error)
    except KeyboardInterrupt:
        print("agentd: interrupted", file=sys.stderr)
        return exit_codes.CTRL_C
    except BrokenPipeError:  # the reader of our output has closed it, as head does
        sys.stderr.close()
        return exit_codes.FAILED


def _never_fail_to_print() -> None:
    """Replace what standard output and error cannot encode: by ASCII where there is a usual form, else by ``?``."""
    codecs.register_error("ascii_signs", _in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="ascii_signs")


def _in_ascii(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(_SIGNS.get(each, "?") for each in error.object[error.start : error.end]), error.end


def _print_error(error: DcfError) -> None:
    """Print one line per problem; before them the traceback, if the error comes from an exception in user code."""
    if isinstance(error, AlgorithmError | FaultError | PlantError) and not isinstance(error.__cause__, DcfError | None):
        traceback.print_exception(error.__cause__)
    for line in str(error).splitlines():
        print(f"agentd: {line}", file=sys.stderr)


class _PrintVersion(argparse.Action):
    """Prints the version and exits. Unlike argparse's own action it looks the version up only when asked for it."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        print(f"dcf-zenoh {dcf_zenoh.__version__}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="agentd", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--version", action=_PrintVersion, nargs=0, help="show program's version number and exit")
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

    fleet, results = fleet_options(), result_options()
    add_flights(command, fleet, results)
    add_interventions(command)
    add_runs(command, results)
    add_emulator(command)
    return parser
