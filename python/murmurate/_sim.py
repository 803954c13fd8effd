"""Simulations of a policy."""

from __future__ import annotations

import dataclasses
import json
import os
from typing import Any

from ._module import sim_json
from ._program import child_of, words_of
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
    report: dict[str, Any] = dataclasses.field(repr=False)


def sim(
    scenario: str = "passage",
    policy: Any = None,
    mode: str = "sim",
    **flags: Any,
) -> Results:
    """Runs episodes in one process under virtual time.

    Every flag of ``murmurate sim`` is a keyword: ``--delay-ms 20`` is ``delay_ms=20``, a switch such as ``--watch`` is
    ``watch=True``, and a list repeats its flag. Ctrl-C ends the run with ``KeyboardInterrupt``. Other threads of Python go
    on while it runs.

    Args:
        scenario: Task of the team.
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
    words = ["--scenario", scenario]
    if policy is not None:
        words += ["--policy", os.fspath(policy)]
    words += words_of(flags)
    report = json.loads(sim_json(child_of([]), words))
    known = {field.name for field in dataclasses.fields(Results)} - {"report", "success_ci95"}
    return Results(
        **{name: report[name] for name in known}, success_ci95=tuple(report["success_ci95"]), report=report
    )
