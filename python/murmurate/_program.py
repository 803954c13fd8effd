"""The program as a child process: its flags from keywords, its results, and Ctrl-C that lets it save."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

#: Number of times that a part of a run is begun again after its process was killed.
RETRIES = 3
#: Time between two looks at whether a run is to stop [s].
LOOK_S = 0.1


def words_of(flags: Mapping[str, Any]) -> list[str]:
    """Returns the flags of the program that keywords stand for.

    ``delay_ms=20`` is ``--delay-ms=20``, ``watch=True`` is ``--watch``, and a list or a tuple repeats its flag. None and
    False leave a flag out.
    """
    words = []
    for name, value in flags.items():
        flag = "--" + name.replace("_", "-")
        for one in value if isinstance(value, (list, tuple)) else [value]:
            if one is True:
                words.append(flag)
            elif one is not None and one is not False:
                words.append(f"{flag}={os.fspath(one) if isinstance(one, os.PathLike) else one}")
    return words


#: First statements of a child, in which no module may come from the current folder or from elsewhere than in its parent:
#: it loads this package from where the parent has it, and looks where the parent looks, after its own standard library.
_BOOT = """\
import sys
sys.path[:] = [folder for folder in sys.path if folder != ""]
import importlib.util, json
folder, others = json.loads(sys.argv.pop(2))
sys.path += [other for other in others if other not in sys.path]
where = {"submodule_search_locations": [folder]}
spec = importlib.util.spec_from_file_location("murmurate", folder + "/__init__.py", **where)
sys.modules["murmurate"] = package = importlib.util.module_from_spec(spec)
spec.loader.exec_module(package)
from murmurate import _child
_child.run()
"""


def safely() -> list[str]:
    """Words that start this interpreter without the current folder in its path, where the interpreter has a flag for it."""
    return [sys.executable, *(["-P"] if sys.version_info >= (3, 11) else [])]


def child_of(words: Sequence[str]) -> list[str]:
    """Returns the command that runs the program as a child of this process, with this package and these arguments."""
    folder = os.path.dirname(os.path.abspath(__file__))
    others = [other for other in map(os.path.abspath, filter(None, sys.path)) if other != os.getcwd()]
    # Its own name is for those who look at a list of processes.
    return [*safely(), "-c", _BOOT, "murmurate._child", json.dumps([folder, others]), str(os.getpid()), *words]


@contextlib.contextmanager
def _started(words: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    """Starts the program and ends it with the block: by Ctrl-C, which lets it save, if an exception leaves the block."""
    command = child_of(words)
    # A session of its own: Ctrl-C of a terminal reaches it once, from here.
    pipe = subprocess.PIPE
    child = subprocess.Popen(command, stdout=pipe, stderr=pipe, stdin=subprocess.DEVNULL, text=True, start_new_session=True)
    with child:
        try:
            yield child
        except BaseException:
            child.send_signal(signal.SIGINT)
            child.communicate()
            raise


def _output(child: subprocess.Popen[str], stop: threading.Event | None) -> tuple[str, str]:
    """Returns what the child says on stdout and stderr until it ends. Raises KeyboardInterrupt if it is to stop."""
    while True:
        try:
            return child.communicate(timeout=LOOK_S)
        except subprocess.TimeoutExpired:
            if stop is not None and stop.is_set():
                raise KeyboardInterrupt from None


def finished(words: Sequence[str], stop: threading.Event | None = None) -> str:
    """Runs the program to its end and returns what it says on stdout. Once ``stop`` is set, it is interrupted.

    Raises:
        ValueError: A flag or a file is wrong; the message names it.
        ChildProcessError: The program was killed.
        RuntimeError: The run has failed.
        KeyboardInterrupt: Ctrl-C; the program has saved what it had.
    """
    with _started(words) as child:
        out, said = _output(child, stop)
    if child.returncode == 0:
        return out
    said = said.strip().removeprefix("error: ")
    if child.returncode == 2:
        raise ValueError(said)
    if child.returncode < 0:
        raise ChildProcessError(f"'murmurate {' '.join(words)}' was killed by signal {-child.returncode}")
    raise RuntimeError(said or f"'murmurate {' '.join(words)}' has ended with exit code {child.returncode}")


def report(words: Sequence[str]) -> dict[str, Any]:
    """Runs the program to its end with ``--json`` and returns what it prints. Errors are those of :func:`finished`."""
    return json.loads(finished([*words, "--json", "--quiet"]))


def again_if_killed(words: Sequence[str], stop: threading.Event | None = None) -> str:
    """Runs the program as :func:`finished` does, and begins again, up to three times, if its process was killed."""
    for left in reversed(range(RETRIES + 1)):
        try:
            return finished(words, stop)
        except ChildProcessError:
            if left == 0:
                raise
    raise AssertionError("the last attempt returns or raises")
