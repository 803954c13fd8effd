"""Tasks in Python: the class that a task is a subclass of, and the state that its methods get."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ._draws import Draws


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """True states of the robots of N environments, world frame, after a step or at the start of an episode.

    The arrays are read-only and are not written again: they may be kept. R is the number of robots of an environment.

    Attributes:
        position: Position [m] of the point that each robot's policy commands, its centre unless its drive is differential
            (N, R, 2).
        velocity: Velocity [m/s] (N, R, 2).
        start: Place at which each robot began the episode [m] (N, R, 2).
        goal: Place that each robot has to reach [m] (N, R, 2).
        wall: Whether each robot has touched a wall in the last step (N, R).
        robot: Whether each robot has touched another robot in the last step (N, R).
        arrived: Whether each robot has arrived in this episode (N, R).
        to_go_m: Length of each robot's shortest path to its goal around the walls [m] (N, R).
        progress_m: Length by which that path became shorter in the last step [m] (N, R).
        time_s: Time since the start of the episode [s] (N).
    """

    position: NDArray[np.float32]
    velocity: NDArray[np.float32]
    start: NDArray[np.float32]
    goal: NDArray[np.float32]
    wall: NDArray[np.bool_]
    robot: NDArray[np.bool_]
    arrived: NDArray[np.bool_]
    to_go_m: NDArray[np.float32]
    progress_m: NDArray[np.float32]
    time_s: NDArray[np.float32]

    def rows(self, index: Any) -> State:
        """Returns the state of some environments, by a mask, a slice or indices along the first axis."""
        names = [field.name for field in dataclasses.fields(self)]
        arrays = {name: np.array(getattr(self, name)[index]) for name in names}
        for array in arrays.values():
            array.flags.writeable = False
        return State(**arrays)


class Scenario:
    """A task of yours: attributes with the names of the fields of a task file, and methods, all of which may be left out.

    Attributes of the class or of the instance are the fields of docs/tasks.md: ``name`` (left out, it is made of the name
    of the class), ``about``, ``robots`` (a dict, or one number), ``half_extent_m`` or ``ground``, ``hull_m``, ``walls``,
    ``obstacles``, ``start`` and ``goal``, ``area``, ``exchange``, ``places``, ``goals``, ``rules``, ``reward`` (weights,
    where there is no method of this name) and ``scripted_success``. Names of attributes of your own begin with ``_``, or
    are not like a field's.

    Methods get arrays of many environments and work on all of them together. A method must not change what it gets, nor
    keep anything in ``self``, and a row of its result must depend on the same row of its arguments alone.
    :func:`murmurate.check_scenario` tests that.

    Attributes:
        num_robots: Number of robots R of an environment, while a method is called.
    """

    num_robots: int
    name: ClassVar[str]
    about: ClassVar[str]
    robots: ClassVar[int | Mapping[str, int]]
    half_extent_m: ClassVar[Sequence[float]]
    ground: ClassVar[Mapping[str, Any]]
    hull_m: ClassVar[float]
    walls: ClassVar[Sequence[Mapping[str, Any]]]
    obstacles: ClassVar[Sequence[Mapping[str, Any]]]
    start: ClassVar[Mapping[str, Any]]
    goal: ClassVar[Mapping[str, Any]]
    area: ClassVar[Mapping[str, Any]]
    exchange: ClassVar[Sequence[Mapping[str, Any]]]
    places: ClassVar[Sequence[Sequence[float]]]
    goals: ClassVar[str]
    rules: ClassVar[Mapping[str, float]]
    scripted_success: ClassVar[float]

    def reset(self, rng: Draws, n: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Returns starts and goals of n episodes [m], world frame, each (n, R, 2).

        Robots are placed at their starts, at rest. Without this method the areas or places of the task have them.

        Args:
            rng: Random numbers, with methods as those of ``numpy.random.Generator``, whose arrays have n rows. A row is
                drawn from the random numbers of its episode alone.
            n: Number of episodes.
        """
        raise NotImplementedError

    def observe(self, state: State) -> NDArray[np.float32]:
        """Returns what each robot observes beside the entries of its configuration (N, R, K)."""
        raise NotImplementedError

    def reward(self, state: State) -> NDArray[np.float32]:
        """Returns the reward of each robot for a step (N, R), in place of that of the configuration."""
        raise NotImplementedError

    def done(self, state: State) -> NDArray[np.bool_]:
        """Returns where episodes end, (N), or for which robots, (N, R): then they end with the last robot.

        An episode also ends when all robots have arrived, and when its time is over.
        """
        raise NotImplementedError


#: A task: a name, the path of a task file, or a task in Python.
Task: TypeAlias = "str | os.PathLike[str] | Scenario | type[Scenario]"
#: Methods that a task may have.
METHODS = ("reset", "observe", "reward", "done")
#: Fields of a task file, in the order in which they are written.
FIELDS = (
    "name",
    "about",
    "robots",
    "half_extent_m",
    "ground",
    "hull_m",
    "walls",
    "obstacles",
    "start",
    "goal",
    "area",
    "exchange",
    "places",
    "goals",
    "rules",
    "reward",
    "scripted_success",
)
