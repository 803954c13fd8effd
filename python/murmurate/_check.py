"""Contract tests of a task in Python."""

from __future__ import annotations

from typing import Any

import numpy as np

from ._bound import Bound, bound
from ._module import VecEnv, broken_contract
from ._scenario import Scenario
from ._sim import sim

#: Number of environments, and of steps, in which methods are called.
ENVIRONMENTS, STEPS = 6, 40


def check_scenario(
    scenario: Scenario | type[Scenario], *, num_robots: int | None = None, episodes: int = 40, seed: int = 0
) -> None:
    """Tests a task in Python for everything that environments, simulations and trainings require of it.

    These are the contract tests of tasks in Rust and in files: places have room, and are apart from each other and from
    their goals, and equal seeds give equal layouts. Then each method: type and shape of its result, finite values, equal
    results of equal calls, and rows that do not depend on other rows. At last scripted navigation has to reach
    ``scripted_success``.

    Args:
        scenario: Instance or class.
        num_robots: Size of the team; None takes that of the task.
        episodes: Number of episodes of scripted navigation; 0 leaves it out.
        seed: Seed of its layouts.

    Raises:
        ValueError: A promise is broken: one line that names the first one.
        RuntimeError: A method has raised an exception.
    """
    task = bound(scenario)
    if task is None:
        raise ValueError("scenario: it is no task in Python; 'murmurate task check FILE.toml' checks a task file")
    broken = broken_contract(task)
    if broken is not None:
        raise ValueError(f"{task.class_name}: {broken}")
    if task.methods:
        _check_methods(task, num_robots)
        _check_environments(task, num_robots)
    if episodes:
        robots = {} if num_robots is None else {"robots": num_robots}
        rate = sim(task.scenario, "orca", "sim", episodes=episodes, seed=seed, **robots).success_rate
        wanted = getattr(task.scenario, "scripted_success", 0.9)
        if rate < wanted:
            why = f"scripted navigation succeeds in {rate:.1%} of {episodes} episodes, and the task demands {wanted:.1%}"
            raise ValueError(f"{task.class_name}.scripted_success: {why}")


def _check_methods(task: Bound, num_robots: int | None) -> None:
    """Calls each method twice, and with some of the rows."""
    env = VecEnv(task.scenario, ENVIRONMENTS, num_robots=num_robots, autoreset="disabled")
    robots, stream = env.num_robots, np.random.default_rng(0)
    if "reset" in task.methods:
        seeds, episodes = list(range(ENVIRONMENTS)), [0] * ENVIRONMENTS
        for at in (0, 1):
            draw = lambda rows: task.reset(robots, seeds[rows], episodes[rows])[at]
            _check_rows(task, "reset", draw)
        if np.array_equal(draw(slice(0, 1)), draw(slice(1, 2))):
            raise ValueError(f"{task.class_name}.reset: two episodes have the same goals; draw them from rng")
    for step in range(STEPS):
        if step % 10 == 0:
            state = env.truth()
            for method in sorted(task.methods - {"reset"}):
                _check_rows(task, method, lambda rows: getattr(task, method)(robots, state.rows(rows)))
        actions = stream.uniform(-1.0, 1.0, (ENVIRONMENTS, robots, 2))
        env.step(actions.astype(np.float32))


def _check_rows(task: Bound, method: str, call: Any) -> None:
    """Compares the result of a method for all rows with that for all again, for some and for one."""
    whole = call(slice(None))
    if not np.array_equal(whole, call(slice(None))):
        why = "two calls with the same arguments differ; draw from rng alone, and keep nothing between calls"
        raise ValueError(f"{task.class_name}.{method}: {why}")
    for rows in (slice(0, 2), slice(ENVIRONMENTS - 1, None)):
        part = call(rows)
        # Sums over arrays of other sizes may be rounded in another way.
        same = np.allclose(whole[rows], part, 1e-4, 1e-5) if part.dtype.kind == "f" else np.array_equal(whole[rows], part)
        if not same:
            why = "the result for an environment depends on the others; work on each row of the arrays on its own"
            raise ValueError(f"{task.class_name}.{method}: {why}")


def _check_environments(task: Bound, num_robots: int | None) -> None:
    """Compares environments beside many others with the same ones beside few, and with their copies."""
    many = VecEnv(task.scenario, ENVIRONMENTS, num_robots=num_robots, conditions="late", seed=1)
    few = VecEnv(task.scenario, 2, num_robots=num_robots, conditions="late", seed=1)
    stream = np.random.default_rng(0)
    for step in range(STEPS):
        if step == STEPS // 2:
            few = few.copy()
        actions = stream.uniform(-1.0, 1.0, (ENVIRONMENTS, many.num_robots, 2)).astype(np.float32)
        many.step(actions)
        few.step(np.ascontiguousarray(actions[:2]))
        for name in ("obs", "observed", "reward", "terminated", "truncated"):
            if not np.allclose(getattr(many, name)[:2], getattr(few, name), 1e-4, 1e-5):
                why = f"'{name}' of an environment depends on the number of environments, or differs in a copy"
                raise ValueError(f"{task.class_name}: {why}; a method keeps something between calls")
