"""Rates of the environments: steps of environments a second of processor time, with random actions on one thread.

    python python/tests/rates.py [vmas]

With `vmas` (pip install vmas) its `passage` and `navigation` are measured in turn with ours.
"""

import pathlib
import statistics
import sys
import tempfile
import time

import numpy as np

from murmurate import VecEnv

N, ROUNDS, STEPS = 1024, 5, 100
LIDAR = pathlib.Path(tempfile.mkdtemp()) / "lidar.toml"
LIDAR.write_text("[senses.lidar]\nkind = 'lidar'\nrays = 32\nrange_m = 2.0\n")


def ours(**options):
    env = VecEnv("passage", N, **options)
    random = np.random.default_rng(0)
    actions = [random.uniform(-1, 1, (N, env.num_robots, 2)).astype(np.float32) for _ in range(8)]
    said = None
    if options.get("message") == "action":
        said = random.uniform(-1, 1, (N, env.num_robots, env.said.shape[3])).astype(np.float32)

    def step(index):
        env.step(actions[index % 8], *([said] if said is not None else []))

    return step


def crossing():
    env = VecEnv("passage", 1, num_robots=2)
    actions = np.zeros((1, 2, 2), np.float32)
    return lambda _: env.step(actions)


def theirs(scenario, agents):
    import torch
    import vmas

    torch.set_num_threads(1)
    env = vmas.make_env(scenario, num_envs=N, device="cpu", continuous_actions=True, n_agents=agents, max_steps=400)
    actions = [[torch.rand(N, 2) * 2 - 1 for _ in env.agents] for _ in range(8)]
    return lambda index: env.step(actions[index % 8])


cases = {
    "passage, perfect": (ours(), STEPS, N),
    "passage, perfect, messages": (ours(message="observations"), STEPS, N),
    "passage, late": (ours(conditions="late"), STEPS, N),
    "passage, late, messages": (ours(conditions="late", message="observations"), STEPS, N),
    "passage, late, floats of policies": (ours(conditions="late", message="action"), STEPS, N),
    "passage, perfect, lidar of 32 rays": (ours(senses=LIDAR), STEPS, N),
    "two robots: a crossing and its step": (crossing(), 50 * STEPS, 1),
}
if "vmas" in sys.argv:
    cases["VMAS passage"] = (theirs("passage", 5), 10, N)
    cases["VMAS navigation"] = (theirs("navigation", 5), 10, N)
rates = {name: [] for name in cases}
for _ in range(ROUNDS):
    for name, (step, steps, environments) in cases.items():
        step(0)
        began = time.process_time()
        for index in range(steps):
            step(index)
        rates[name].append(environments * steps / (time.process_time() - began))
for name, found in rates.items():
    print(f"{name:36} {statistics.median(found):12,.0f} a second of one core")
