"""Our `navigation` beside VMAS's task of that name, at equal sizes and on one thread each.

    python python/tests/against_vmas.py          (pip install vmas)

Robots of a radius of 0.1 m go to goals of their own on a ground of 2 m x 2 m, and see each other by a lidar of 12 rays that
reach 0.35 m, as in VMAS. VMAS runs with each of several numbers of environments, and its best one counts. Both are
measured in turn, by processor time, with random actions.
"""

import pathlib
import statistics
import sys
import tempfile
import time

import numpy as np
import torch
import vmas

from murmurate import VecEnv

ROUNDS, SECONDS = 5, 2.0
SIZES = [256, 1024, 4096, 16384]
TASK = """
name = "navigation-of-vmas"
about = "robots go to goals of their own on open ground"
robots = {{ default = {robots}, least = 2, most = 12 }}
half_extent_m = [3.0, 3.0]
hull_m = 0.1
area = {{ rect = [-1.0, -1.0, 1.0, 1.0] }}
rules = {{ arrival_m = 0.1, limit_s = 60.0 }}
"""
LIDAR = "[senses.lidar]\nkind = 'lidar'\nrays = 12\nrange_m = 0.35\n"
folder = pathlib.Path(tempfile.mkdtemp())


def ours(robots, size):
    task, senses = folder / f"{robots}.toml", folder / "senses.toml"
    task.write_text(TASK.format(robots=robots))
    senses.write_text(LIDAR)
    env = VecEnv(str(task), size, senses=senses, threads=1)
    random = np.random.default_rng(0)
    actions = [random.uniform(-1, 1, (size, robots, 2)).astype(np.float32) for _ in range(8)]
    return lambda index: env.step(actions[index % 8])


def theirs(robots, size):
    env = vmas.make_env("navigation", num_envs=size, device="cpu", continuous_actions=True, n_agents=robots, seed=0)
    actions = [[torch.rand(size, 2) * 2 - 1 for _ in env.agents] for _ in range(8)]
    return lambda index: env.step(actions[index % 8])


def rate(step, size):
    step(0)
    began, steps = time.process_time(), 0
    while time.process_time() - began < SECONDS:
        step(steps)
        steps += 1
    return size * steps / (time.process_time() - began)


torch.set_num_threads(1)
with torch.no_grad():
    for robots in map(int, sys.argv[1:] or ["4", "8"]):
        best = max(SIZES, key=lambda size: rate(theirs(robots, size), size))
        mine, other = ours(robots, 1024), theirs(robots, best)
        pairs = [(rate(mine, 1024), rate(other, best)) for _ in range(ROUNDS)]
        ratio = statistics.median(a / b for a, b in pairs)
        a, b = (statistics.median(column) for column in zip(*pairs))
        print(f"{robots} robots: {a:,.0f} steps of environments a second, VMAS {b:,.0f} with {best}: x{ratio:.1f}")
