"""The command line ``murmurate``, as the program of the same name has it."""

import signal
import sys

from ._module import run_program
from ._program import safely


def main() -> int:
    """Runs the program with this process's arguments and returns its exit code."""
    # Python leaves Ctrl-C to the program, which saves what it has.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return run_program([*safely(), "-m", "murmurate"], sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
