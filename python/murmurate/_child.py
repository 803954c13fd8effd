"""The program as a child of a Python process: it is interrupted, and saves, if that process ends before it."""

import ctypes
import os
import signal
import sys

from .__main__ import main

#: ``PR_SET_PDEATHSIG`` of Linux.
_SIGNAL_WITH_PARENT = 1


def _end_with(parent: int) -> None:
    """Asks the kernel for an interrupt when the parent ends. Other systems than Linux have no such request."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_SIGNAL_WITH_PARENT, signal.SIGINT)
        if os.getppid() != parent:
            sys.exit(130)


def run() -> None:
    """Runs the program with this process's arguments, of which the first two are a name and the parent's number."""
    del sys.argv[1]
    _end_with(int(sys.argv.pop(1)))
    sys.exit(main())
