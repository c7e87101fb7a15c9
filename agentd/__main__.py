"""``python -m agentd``, and the command ``agentd``."""

import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    del sys.path[0]  # the working directory: a file of a user there may have the name of any module

import os
import threading
import time

END_WITHIN = 5.0  # s that the interpreter may take to end after a command


def main() -> int:
    """Run the command line; return its exit code. Handles Ctrl-C during the imports, too.

    The two commands that end a flight begin at once, without the imports that other commands need.
    """
    try:
        match sys.argv[1:]:
            case ["land" | "stop" as how, name] if not name.startswith("-"):
                from agentd.operator.land_stop import main as end  # noqa: PLC0415

                return end(how, name)
        from agentd.cli import main  # noqa: PLC0415 - takes so long that Ctrl-C may come meanwhile

        return main()
    except KeyboardInterrupt:
        print("agentd: interrupted", file=sys.stderr)
        return 130
    finally:
        threading.Thread(target=_end_process, name="deadline-of-the-end", daemon=True).start()


def _end_process() -> None:
    """End a process that does not end by itself, because of a thread or a half-open session that is left."""
    time.sleep(END_WITHIN)
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
