"""``python -m agentd``, and the command ``agentd``."""

import sys


def main() -> int:
    """Run the command line; its exit code. Ctrl-C is answered properly from the first import on."""
    try:
        from agentd.cli import main  # noqa: PLC0415 - imports take a while

        return main()
    except KeyboardInterrupt:
        print("agentd: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
