"""How a case ends: with 0 if all is as expected, with 1 and the reason if not."""

import os
import pathlib
import sys

#: Empty folder of the case.
WORK = pathlib.Path(os.environ.get("CASE_WORK") or ".").absolute()


def expect(held, what):
    """Ends the case with a failure unless what is expected holds."""
    if not held:
        sys.exit(f"not as expected: {what}")


def refused(call, error, words):
    """Expects that a call raises this error with these words in it."""
    try:
        result = call()
    except error as raised:
        expect(words in str(raised), f"'{raised}' says nothing of '{words}'")
    except BaseException as raised:
        sys.exit(f"not as expected: {type(raised).__name__}: {raised}, instead of {error.__name__} with '{words}'")
    else:
        sys.exit(f"not as expected: {result!r}, instead of {error.__name__} with '{words}'")
