"""``python -m agentd``, and the command ``agentd``."""

import sys


def main() -> int:
    """Run the command line; return its exit code. Handles Ctrl-C during the imports, too."""
    try:
        from agentd.cli import main  # noqa: PLC0415 - takes so long that Ctrl-C may come meanwhile

        return main()
    except KeyboardInterrupt:
        print("agentd: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
