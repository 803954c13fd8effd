"""Trainings, and sweeps of them."""

from __future__ import annotations

import csv
import dataclasses
import itertools
import json
import os
import pathlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ._bound import named
from ._executors import Executor, run_all
from ._program import report, words_of
from ._scenario import Task


@dataclasses.dataclass(frozen=True)
class Training:
    """Result of a training.

    Attributes:
        folder: Folder with policy, checkpoint, curve and configuration.
        policy: Policy file, for ``sim``, ``study`` and robots.
        decisions: Number of decisions that it was trained on.
        evaluation: Results of a quick evaluation at the end, one dictionary for each condition and kind of action.
        report: Everything that ``murmurate train --json`` prints.
    """

    folder: pathlib.Path
    policy: pathlib.Path
    decisions: int
    evaluation: list[dict[str, Any]]
    report: dict[str, Any] = dataclasses.field(repr=False)

    @property
    def curve(self) -> dict[str, list[float]]:
        """The learning curve as lists by field, as ``pandas.DataFrame(training.curve)`` takes them; NaN is unknown."""
        with open(self.folder / "curve.csv", newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        fields = rows[0] if rows else {}
        return {field: [float(row[field] or "nan") for row in rows] for field in fields}


def train(
    scenario: Task = "passage",
    *,
    out: str | os.PathLike[str],
    fields: Mapping[str, Any] | None = None,
    resume: bool | None = None,
    **flags: Any,
) -> Training:
    """Trains a policy in a process of the program.

    Every flag of ``murmurate train`` is a keyword, such as ``steps=1_000_000``, ``config="mine.toml"`` and ``seed=3``.

    Args:
        scenario: Task of the team: a name, a task file, or a task in Python without methods, of which ``out`` then has
            the task file.
        out: Folder for policy, checkpoint, curve and configuration.
        fields: Fields of the configuration: ``{"ppo.clip": 0.1, "conditions.lag_s": [0.2, 0.4]}``.
        resume: Whether to go on from the checkpoint in ``out``; None goes on if there is one.

    Raises:
        ValueError: A flag, a field or a file is wrong; the message names it.
        RuntimeError: The training has failed, such as by divergence.
        KeyboardInterrupt: Ctrl-C; everything is saved, and the same call goes on from there.
    """
    return _of(report(_words(named(scenario, out), pathlib.Path(out), fields or {}, resume, flags)))


def sweep(
    scenario: Task = "passage",
    *,
    out: str | os.PathLike[str],
    steps: int,
    seeds: Iterable[int] = (0,),
    over: Mapping[str, Sequence[Any]] | None = None,
    executor: Executor = "processes",
    workers: int = 1,
    threads: int = 1,
    **flags: Any,
) -> list[tuple[dict[str, Any], Training]]:
    """Trains a policy for every seed and every combination of fields, each in a folder of its own.

    A training whose process or machine is lost goes on from its checkpoint, on another if there is one: so do all after
    Ctrl-C, with the same call. The weights do not depend on any of this.

    Args:
        scenario: Task of the team: a name, a task file, or a task in Python without methods, of which ``out`` then has
            the task file.
        out: Folder for one folder a training; with ``executor="ray"`` on a disk that all machines share.
        steps: Number of decisions of each training.
        seeds: Seeds of the random numbers.
        over: Values of fields of the configuration: ``{"ppo.clip": [0.1, 0.2]}``.
        executor: "processes" of this machine, or the workers of a "ray" cluster.
        workers: Number of trainings at a time.
        threads: Threads of each training.
        flags: Further flags of ``murmurate train``, the same for all.

    Returns:
        For each training its seed and fields, and its result, in the order of ``over`` and ``seeds``.

    Raises:
        ValueError, RuntimeError, KeyboardInterrupt: As for :func:`train`.
    """
    over, seeds = dict(over or {}), list(seeds)
    flags = {**flags, "steps": steps, "threads": threads}
    points = [
        {**dict(zip(over, values)), "seed": seed} for values in itertools.product(*over.values()) for seed in seeds
    ]
    names = [",".join(f"{field}={_text(value)}" for field, value in point.items()) for point in points]
    for name in names:
        if len(name) > 200 or "/" in name:
            raise ValueError(f"over: '{name}' cannot be the name of a folder")
    task = named(scenario, os.path.abspath(out))
    pathlib.Path(out).mkdir(parents=True, exist_ok=True)
    commands = []
    for name, point in zip(names, points):
        fields = {field: value for field, value in point.items() if field != "seed"}
        folder = pathlib.Path(os.path.abspath(out)) / name
        words = _words(task, folder, fields, None, {**flags, "seed": point["seed"]})
        commands.append([*words, "--json", "--quiet"])
    said = run_all(commands, executor, workers)
    return [(point, _of(json.loads(one))) for point, one in zip(points, said)]


def _words(
    scenario: str, out: pathlib.Path, fields: Mapping[str, Any], resume: bool | None, flags: Mapping[str, Any]
) -> list[str]:
    """Returns the arguments of a training."""
    sets = [word for field, value in fields.items() for word in ("--set", f"{field}={_text(value)}")]
    how = {None: "--resume=if-there", True: "--resume", False: ""}[resume]
    return ["train", scenario, "--out", os.fspath(out), *filter(None, [how]), *sets, *words_of(flags)]


def _text(value: Any) -> str:
    """Returns a value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_text, value)) + "]"
    return json.dumps(value) if isinstance(value, str) else str(value)


def _of(report: dict[str, Any]) -> Training:
    """Makes the result from what the program prints."""
    policy = pathlib.Path(report["policy"])
    return Training(policy.parent, policy, report["decisions"], report["evaluation"] or [], report)
