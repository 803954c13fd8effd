"""Simulations of a policy."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import pathlib
import tempfile
from collections.abc import Iterator
from typing import Any

from ._bound import Bound, bound
from ._module import VecEnv, sim_json, sim_task_json
from ._program import child_of, words_of
from ._scenario import Task
from ._served import is_factory, is_object, served


@dataclasses.dataclass(frozen=True)
class Results:
    """Results of a simulation.

    Attributes:
        mode: Mode of the deployment.
        scenario: Task of the team.
        policy: Name of the policy.
        robots: Number of robots.
        episodes: Number of episodes with a result.
        successes: Number of successful episodes.
        success_rate: Share of successful episodes, 0 to 1.
        success_ci95: Ends of the 95 % Wilson interval of the success rate.
        makespan_median_s: Median time until all robots had arrived [s]; None without a success.
        robot_collisions: Episodes that failed because robots touched each other.
        wall_collisions: Episodes that failed because a robot touched a wall.
        timeouts: Episodes that ran out of time.
        aborted: Episodes that were aborted.
        trace_hash: Digest of all messages and motions; the command line prints the same for the same flags.
        returns: Sum of the rewards of each judged episode, the mean of its robots, for a task in Python with a method
            ``reward``; empty for others.
        report: Everything that ``murmurate sim --json`` prints.
    """

    mode: str
    scenario: str
    policy: str
    robots: int
    episodes: int
    successes: int
    success_rate: float
    success_ci95: tuple[float, float]
    makespan_median_s: float | None
    robot_collisions: int
    wall_collisions: int
    timeouts: int
    aborted: int
    trace_hash: str
    returns: list[float]
    report: dict[str, Any] = dataclasses.field(repr=False)

    @property
    def mean_return(self) -> float | None:
        """Mean of the returns; None without any."""
        return math.fsum(self.returns) / len(self.returns) if self.returns else None


def sim(
    scenario: Task = "passage",
    policy: Any = None,
    mode: str = "sim",
    **flags: Any,
) -> Results:
    """Runs episodes in one process under virtual time.

    Every flag of ``murmurate sim`` is a keyword: ``--delay-ms 20`` is ``delay_ms=20``, a switch such as ``--watch`` is
    ``watch=True``, and a list repeats its flag. Ctrl-C ends the run with ``KeyboardInterrupt``. Other threads of Python go
    on while it runs.

    Args:
        scenario: Task of the team: a name, a task file, or a task in Python (:class:`murmurate.Scenario`).
        policy: Name in the registry, a policy file, an object such as a :class:`Policy` with an attribute ``contract``,
            which is asked by one job, or a function without arguments that makes such an object for each job; None takes
            the shipped policy. One call has the inputs of all robots of an agent: in mode sim, of the team.
        mode: Mode of the paper: sim, centralized, offboard, onboard-infra, onboard-adhoc.

    Raises:
        ValueError: A flag or a file is wrong; the message names it.
    """
    if is_object(policy):
        if not is_factory(policy) and flags.setdefault("jobs", 1) != 1:
            raise ValueError("jobs: an object is asked by one job; give a function that makes one for each job")
        with served(policy) as (file, name):
            return dataclasses.replace(sim(scenario, file, mode, **flags), policy=name)
    if "deployment" not in flags:
        flags["mode"] = mode
    task, returns = bound(scenario), []
    if policy is not None:
        flags["policy"] = os.fspath(policy)
    if task is None:
        report = json.loads(sim_json(child_of([]), ["--scenario", os.fspath(scenario), *words_of(flags)]))
    else:
        if flags.get("record") and task.methods:
            why = f"a record cannot hold the methods of {task.class_name}, so it could not be replayed; leave it out"
            raise ValueError(f"record: {why}")
        with _perceiving(task, flags) as words:
            said, sums = sim_task_json(child_of([]), words, task)
        report, returns = json.loads(said), [sum_ for _, _, sum_ in sums]
    known = {field.name for field in dataclasses.fields(Results)} - {"report", "success_ci95", "returns"}
    return Results(
        **{name: report[name] for name in known},
        success_ci95=tuple(report["success_ci95"]),
        returns=returns,
        report=report,
    )


@contextlib.contextmanager
def _perceiving(task: Bound, flags: dict[str, Any]) -> Iterator[list[str]]:
    """Yields the flags as words, with the sense ``observed`` if a policy file may take it and the task observes."""
    named = "policy" not in flags or not ("." in flags["policy"] or os.sep in flags["policy"])
    if named or "observe" not in task.methods:
        yield words_of(flags)
        return
    floats = VecEnv(task, 1, num_robots=flags.get("robots")).observed.shape[2]
    with tempfile.TemporaryDirectory() as folder:
        file, others = pathlib.Path(folder, "senses.toml"), flags.get("senses")
        try:
            text = "" if others is None else pathlib.Path(others).read_text(encoding="utf-8")
        except OSError as error:
            raise ValueError(f"senses: '{others}': {error.strerror}") from None
        file.write_text(f'{text}\n[senses.observed]\nkind = "task"\nfloats = {floats}\n', encoding="utf-8")
        yield words_of({**flags, "senses": file})
