"""Studies of policies."""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

from ._bound import named
from ._executors import Executor, run_all
from ._program import report, words_of

#: Studies of the program that consist of trials, which can be divided.
_OF_TRIALS = ("modes", "delay", "range", "sweep", "commbench")
#: Parts for each worker: a worker that is killed loses a part, and the last ones end at about the same time.
_PARTS = 4


@dataclasses.dataclass(frozen=True)
class Study:
    """Results of a study.

    Attributes:
        study: Name of the study.
        rows: One dictionary for each column, policy and handling (``network``: for each case; ``twin``: for each
            compared quantity; ``sweep``: for each point, with its values in ``at``; ``commbench``: for each policy in each
            cell, with the verdicts in ``report["comparisons"]``), with the fields of
            ``murmurate study ... --json``.
        report: Everything that ``murmurate study ... --json`` prints.
    """

    study: str
    rows: list[dict[str, Any]]
    report: dict[str, Any] = dataclasses.field(repr=False)

    @property
    def columns(self) -> dict[str, list[Any]]:
        """The rows as lists by field, as ``pandas.DataFrame(study.columns)`` takes them."""
        fields = dict.fromkeys(field for row in self.rows for field in row)
        return {field: [row.get(field) for row in self.rows] for field in fields}


def study(
    study: Literal["modes", "delay", "range", "sweep", "commbench", "network", "twin"],
    *records: str | os.PathLike[str],
    out: str | os.PathLike[str] | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    axis: Mapping[str, Sequence[Any]] | None = None,
    **flags: Any,
) -> Study:
    """Runs a study in processes of the program.

    Every flag of ``murmurate study`` is a keyword, and a list repeats its flag: ``policy=["shipped", "orca"]``. With
    ``out``, finished trials are kept there, and the same call goes on after Ctrl-C. The results do not depend on the
    executor, bit for bit.

    Args:
        study: Name of the study.
        records: Records of the run, for ``twin`` alone.
        out: Folder for report, figures and finished trials; with ``executor="ray"`` on a disk that all machines share.
        executor: None for one process with a thread for each core (``jobs=``); "processes" or "ray" for parts
            (``--shard``) in processes with one thread each. Not for ``network`` and ``twin``.
        workers: Number of parts at a time; None takes the cores of this machine.
        axis: One or two axes of a ``sweep``, each with its values: ``{"robots": [6, 8], "radio": ["none", "wifi"]}``.

    Raises:
        ValueError: A flag or a file is wrong; the message names it.
        RuntimeError: The study has failed.
        KeyboardInterrupt: Ctrl-C; finished trials are in ``out``.
    """
    with tempfile.TemporaryDirectory() as temporary:
        if axis is not None:
            flags["axis"] = _axes(axis)
        if "scenario" in flags:
            flags["scenario"] = named(flags["scenario"], temporary if out is None else out)
        return _run(study, records, out, executor, workers, flags)


def _axes(axis: Any) -> list[str]:
    """Returns the values of ``--axis``."""
    if not isinstance(axis, Mapping):
        raise ValueError(f"axis: a {type(axis).__name__} is no dictionary from names to lists of values")
    return [f"{name}={','.join(_values(name, values))}" for name, values in axis.items()]


def _values(name: str, values: Any) -> list[str]:
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise ValueError(f"axis: '{name}' has {values!r}, which is no list of values")
    words = []
    for value in values:
        if value is None:
            raise ValueError(f"axis: a value of '{name}' is None; give the one that it stands for")
        words.append(str(value).lower() if isinstance(value, bool) else str(value))
    return words


def _run(
    study: str,
    records: Sequence[str | os.PathLike[str]],
    out: str | os.PathLike[str] | None,
    executor: Executor | None,
    workers: int | None,
    flags: Mapping[str, Any],
) -> Study:
    words = ["study", study, *map(os.fspath, records), *words_of(flags)]
    if executor is None:
        return _of(report([*words, *words_of({"out": out})]))
    if study not in _OF_TRIALS:
        raise ValueError(f"executor: the study '{study}' has no parts; only {', '.join(_OF_TRIALS)} have")
    if out is None and executor == "ray":
        raise ValueError("out: missing; the machines of a Ray cluster share a folder")
    workers = (os.cpu_count() or 1) if workers is None else workers
    with tempfile.TemporaryDirectory() as temporary:
        kept = ["--out", os.path.abspath(temporary if out is None else out)]
        parts = workers * _PARTS
        shards = [[*words, *kept, "--jobs=1", "--quiet", "--shard", f"{part}/{parts}"] for part in range(1, parts + 1)]
        run_all(shards, executor, workers)
        return _of(report([*words, *kept]))


def _of(report: dict[str, Any]) -> Study:
    """Makes the results from what the program prints."""
    return Study(report["study"], report.get("columns", report.get("rows", [])), report)
