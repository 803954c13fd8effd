"""Executors: where the parts of a study and the trainings of a sweep run."""

from __future__ import annotations

import concurrent.futures
import threading
from collections.abc import Callable, Sequence
from typing import Literal

from ._program import RETRIES, again_if_killed

#: Where parts of a run are computed: in processes of this machine, or by a Ray cluster whose machines share the folder.
Executor = Literal["processes", "ray"]


def run_all(commands: Sequence[Sequence[str]], executor: str, workers: int) -> list[str]:
    """Runs the program with each list of arguments, ``workers`` of them at a time; returns what each says on stdout.

    A process that is killed is begun again, up to three times. Ctrl-C ends all, and each saves what it has.

    Raises:
        ValueError: The executor is unknown, or a flag or a file is wrong.
        ChildProcessError: A process was killed again and again.
        RuntimeError: A run has failed.
        ImportError: Ray is not installed.
    """
    if workers < 1:
        raise ValueError(f"workers: {workers} is not 1 or more")
    runs: dict[str, Callable[..., list[str]]] = {"processes": _processes, "ray": _ray}
    if executor not in runs:
        raise ValueError(f"executor: '{executor}' is neither 'processes' nor 'ray'")
    return runs[executor](commands, workers)


def _processes(commands: Sequence[Sequence[str]], workers: int) -> list[str]:
    """Runs the commands in threads that each wait for a process of their own."""
    stop = threading.Event()
    with concurrent.futures.ThreadPoolExecutor(workers) as pool:
        futures = [pool.submit(again_if_killed, command, stop) for command in commands]
        try:
            for done in concurrent.futures.as_completed(futures):
                done.result()
        except BaseException:
            # Ctrl-C arrives here alone, and the failure of one ends the others.
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
        return [future.result() for future in futures]


def _ray(commands: Sequence[Sequence[str]], workers: int) -> list[str]:
    """Runs the commands as tasks of Ray, which begins a task again on another worker if its worker has died."""
    import ray

    if not ray.is_initialized():
        ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False)
    task = ray.remote(max_retries=RETRIES, num_cpus=1)(again_if_killed)
    return ray.get([task.remote(list(command)) for command in commands])
