"""`starbench`, and `python -m bench`: begins the command line, and takes a Ctrl-C while it still loads."""

from __future__ import annotations

import sys

_BROKEN_OFF = 128 + 2


def main() -> None:
    """Run the command line and exit. Imports it here, where breaking that off is no traceback."""
    try:
        from bench.commands.cli import main as run_command_line

        run_command_line()
    except KeyboardInterrupt:
        sys.stderr.write("Stopped.\n")
        sys.exit(_BROKEN_OFF)


if __name__ == "__main__":
    main()
