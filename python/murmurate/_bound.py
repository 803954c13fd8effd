"""A task in Python with its checks: the text of its task file, and the calls of its methods.

Every mistake is one line that begins with class and attribute or method.
"""

from __future__ import annotations

import copy
import difflib
import inspect
import json
import os
import pathlib
import re
import traceback
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._draws import Draws
from ._scenario import FIELDS, METHODS, Scenario, State, Task

#: Largest number of floats that a robot observes by the method ``observe``.
MOST_FLOATS = 4096


def bound(given: Any) -> Bound | None:
    """Returns an instance or a subclass of :class:`Scenario` with its checks; None for a name or a path.

    Raises:
        ValueError: An attribute is wrong, by class and attribute.
    """
    if isinstance(given, Bound):
        return given
    if inspect.isclass(given):
        if not issubclass(given, Scenario):
            raise ValueError(f"scenario: the class {given.__name__} is no subclass of murmurate.Scenario")
        try:
            given = given()
        except Exception as error:
            why = f"{_one_line(error)}; make an instance yourself and give that"
            raise ValueError(f"{given.__name__}.__init__: {why}") from error
    if isinstance(given, Scenario):
        return Bound(given)
    if isinstance(given, (str, os.PathLike)):
        return None
    raise ValueError(f"scenario: {repr(given)[:80]} is neither a name, nor a file, nor a murmurate.Scenario")


def state(arrays: dict[str, NDArray[Any]]) -> State:
    """Makes a state, whose arrays cannot be written."""
    for array in arrays.values():
        array.flags.writeable = False
    return State(**arrays)


class Bound:
    """A task with its checks."""

    def __init__(self, scenario: Scenario):
        self.scenario = scenario
        self.class_name = type(scenario).__name__
        self.methods = {method for method in METHODS if self._has(method)}
        self._check_names()
        self.text = self._written()
        #: Number of floats that a robot observes, by the number of robots.
        self._floats: dict[int, int] = {}

    def _has(self, method: str) -> bool:
        own = inspect.getattr_static(self.scenario, method)
        if own is inspect.getattr_static(Scenario, method):
            return False
        if method == "reward" and isinstance(own, Mapping):
            return False
        if not callable(getattr(self.scenario, method)):
            also = ", or a dict of weights" if method == "reward" else ""
            raise ValueError(f"{self.class_name}.{method}: a {type(own).__name__} is no method{also}")
        return True

    def _check_names(self) -> None:
        """Refuses attributes whose names are almost those of fields or methods."""
        known = [*FIELDS, *METHODS]
        classes = [one for one in type(self.scenario).__mro__ if one not in (Scenario, object)]
        names = [name for one in [self.scenario, *classes] for name in vars(one) if not name.startswith("_")]
        for name in names:
            like = difflib.get_close_matches(name, known, 1, 0.8)
            if name not in known and like:
                why = f"there is no such field or method; did you mean '{like[0]}'? Begin a name of your own with '_'"
                raise ValueError(f"{self.class_name}.{name}: {why}")

    def _written(self) -> str:
        """Returns the text of the task file."""
        lines = []
        for field in FIELDS:
            value = getattr(self.scenario, field, None)
            if field == "reward" and not isinstance(value, Mapping):
                continue
            if field == "name" and value is None:
                value = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|_", "-", self.class_name).lower()
            if field == "robots" and isinstance(value, int) and not isinstance(value, bool):
                value = {"default": value, "least": value, "most": value}
            is_ground = field == "half_extent_m" and getattr(self.scenario, "ground", None) is None
            if value is None and (is_ground or field in ("robots", "rules")):
                raise ValueError(f"{self.class_name}.{field}: it is missing; docs/tasks.md has the fields of a task")
            if value is not None:
                lines.append(f"{field} = {_toml(value, f'{self.class_name}.{field}')}\n")
        return "".join(lines)

    def reset(self, robots: int, seeds: Sequence[int], episodes: Sequence[int]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Returns starts and goals of episodes, each (n, R, 2)."""
        n = len(seeds)
        drawn = self._call("reset", robots, Draws(seeds, episodes), n)
        if not isinstance(drawn, (tuple, list)) or len(drawn) != 2:
            what = f"{len(drawn)} values" if isinstance(drawn, (tuple, list)) else f"a {type(drawn).__name__}"
            raise ValueError(f"{self.class_name}.reset: it returned {what}; return (start, goal), each ({n}, {robots}, 2)")
        named = zip(("start", "goal"), drawn)
        start, goal = (self._floats_of("reset", array, (n, robots, 2), "(n, R, 2)", f"{of}: ") for of, array in named)
        return start, goal

    def reward(self, robots: int, state: State) -> NDArray[Any]:
        """Returns the rewards (N, R)."""
        rewards = self._call("reward", robots, state)
        return self._floats_of("reward", rewards, (len(state.time_s), robots), "(N, R)")

    def done(self, robots: int, state: State) -> NDArray[Any]:
        """Returns where episodes end (N)."""
        done, n = self._array("done", self._call("done", robots, state)), len(state.time_s)
        if done.dtype.kind != "b":
            raise ValueError(f"{self.class_name}.done: its type is {done.dtype} and not bool; compare, as in x > 0")
        if done.shape == (n, robots):
            done = done.all(axis=1)
        if done.shape != (n,):
            shapes = f"[{n}] (N), nor [{n}, {robots}] (N, R)"
            raise ValueError(f"{self.class_name}.done: its shape is {list(done.shape)}, and neither {shapes}")
        return np.ascontiguousarray(done)

    def observe(self, robots: int, state: State) -> NDArray[Any]:
        """Returns what the robots observe (N, R, K), with one K for all calls."""
        seen, n = self._array("observe", self._call("observe", robots, state)), len(state.time_s)
        if seen.ndim != 3 or not 1 <= seen.shape[2] <= MOST_FLOATS:
            why = f"its shape is {list(seen.shape)} and not [{n}, {robots}, K] (N, R, K), with K from 1 to {MOST_FLOATS}"
            raise ValueError(f"{self.class_name}.observe: {why}")
        floats = self._floats.setdefault(robots, seen.shape[2])
        return self._floats_of("observe", seen, (n, robots, floats), "(N, R, K)")

    def _call(self, method: str, robots: int, *arguments: Any) -> Any:
        try:
            # A copy knows the size of the team, and what a method keeps in it is gone afterwards.
            one = copy.copy(self.scenario)
            one.num_robots = robots
            return getattr(one, method)(*arguments)
        except Exception as error:
            raise RuntimeError(f"{self.class_name}.{method}: {_one_line(error)}") from error

    def _array(self, method: str, given: Any) -> NDArray[Any]:
        try:
            return np.asarray(given)
        except Exception as error:
            raise ValueError(f"{self.class_name}.{method}: it is no array: {_one_line(error)}") from error

    def _floats_of(
        self, method: str, given: Any, shape: tuple[int, ...], axes: str, which: str = ""
    ) -> NDArray[np.float32]:
        """Returns an array of a method as floats, if it is one of finite real numbers in this shape."""
        what, array = f"{self.class_name}.{method}: {which}", self._array(method, given)
        if array.dtype.kind not in "fiu":
            raise ValueError(f"{what}its type is {array.dtype} and not one of real numbers, such as float32")
        if array.shape != shape:
            raise ValueError(f"{what}its shape is {list(array.shape)} and not {list(shape)} {axes}")
        with np.errstate(over="ignore"):
            floats = np.ascontiguousarray(array, np.float32)
        wrong = ~np.isfinite(floats)
        if wrong.any():
            at = np.argwhere(wrong)[0].tolist()
            raise ValueError(f"{what}the value at {at} {axes} is {array[tuple(at)]}; return finite numbers")
        return floats


def named(given: Task, folder: str | os.PathLike[str]) -> str:
    """Returns the name of a task for a process of the program. The file of a task in Python is written to the folder.

    Raises:
        ValueError: The task has methods, which a process of the program cannot call.
    """
    task = bound(given)
    if task is None:
        return os.fspath(given)
    if task.methods:
        why = "a process of the program cannot call a method in Python; leave it out, or take murmurate.VecEnv with a trainer"
        raise ValueError(f"{task.class_name}.{min(task.methods)}: {why} of yours, and murmurate.sim")
    file = pathlib.Path(folder, "task.toml")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(task.text, encoding="utf-8")
    return os.fspath(file)


def _one_line(error: BaseException) -> str:
    """Returns an exception in one line, with the place where it was raised."""
    said = " ".join(str(error).split())
    frames = traceback.extract_tb(error.__traceback__)
    # The place in the task's own file is more use than one within numpy.
    own = [frame for frame in frames if "site-packages" not in frame.filename and frame.filename != __file__]
    place = f" ({os.path.basename(own[-1].filename)}, line {own[-1].lineno})" if own else ""
    return f"{type(error).__name__}{': ' if said else ''}{said}{place}"


def _toml(value: Any, where: str) -> str:
    """Returns a value as TOML. ``where`` is class and attribute, for the error of another type."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, str):
        try:
            value.encode()
        except UnicodeEncodeError:
            raise ValueError(f"{where}: it is no text that can be written: {value!r}") from None
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        entries = [f"{json.dumps(str(key))} = {_toml(one, f'{where}.{key}')}" for key, one in value.items()]
        return "{ " + ", ".join(entries) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml(one, f"{where}[{at}]") for at, one in enumerate(value)) + "]"
    raise ValueError(f"{where}: a {type(value).__name__} is none of number, text, list and dict")
