"""Bars of the scripts that hold hosts against programs of others: figures beside what they must be."""

import os
import sys


def missed(bars):
    """Prints each bar of (name, figure, whether it is met), and returns whether any is missed."""
    for name, figure, met in bars:
        print(f"{name}: {figure}{'' if met else '  MISSED'}", flush=True)
    return not all(met for _, _, met in bars)


def program_of(arguments):
    """Returns the path of the program that the first argument names; ends this one if it is none."""
    program = os.path.abspath(arguments[1]) if len(arguments) > 1 else None
    if not program or not os.access(program, os.X_OK):
        sys.exit(f"no program at {program}")
    return program
