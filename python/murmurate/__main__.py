"""The command line ``murmurate``, as the program of the same name has it."""

import sys

from ._murmurate import run_program


def main() -> int:
    """Runs the program with this process's arguments and returns its exit code."""
    return run_program(["murmurate", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
