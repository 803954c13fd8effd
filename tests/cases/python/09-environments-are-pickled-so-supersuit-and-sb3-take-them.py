"""SuperSuit copies the PettingZoo face, and PPO of Stable-Baselines3 learns on it; so do copies, pickles and new processes."""

import copy
import multiprocessing
import pickle

import cloudpickle
import numpy as np
import supersuit
from lib_expect import expect
from stable_baselines3 import PPO
from torchrl.envs import ParallelEnv

import murmurate
from murmurate.gymnasium import TeamVectorEnv
from murmurate.pettingzoo import parallel_env
from murmurate.torchrl import Env


def first(env, to):
    env.step(np.full((env.num_envs, env.num_robots, 2), 0.3, np.float32))
    to.put(env.obs.tobytes())


if __name__ == "__main__":
    for num_cpus in (0, 2):
        env = supersuit.pettingzoo_env_to_vec_env_v1(parallel_env("passage", episode_s=1.0))
        env = supersuit.concat_vec_envs_v1(env, 2, num_cpus=num_cpus, base_class="stable_baselines3")
        seen = env.reset()
        expect(seen.shape == (10, 6), f"{num_cpus} processes: its shape is {seen.shape}")
        expect(not np.array_equal(seen[:5], seen[5:]), f"{num_cpus} processes: both teams are the same")
        if num_cpus == 0:
            PPO("MlpPolicy", env, n_steps=32, batch_size=80, n_epochs=1, device="cpu").learn(320)
        env.close()
    env = murmurate.VecEnv("passage", 3, conditions="late", message="observations")
    others = [copy.copy(env), copy.deepcopy(env), pickle.loads(pickle.dumps(env)), pickle.loads(cloudpickle.dumps(env))]
    spawn = multiprocessing.get_context("spawn")
    queue = spawn.Queue()
    process = spawn.Process(target=first, args=(env, queue))
    process.start()
    there = queue.get(timeout=120)
    process.join()
    for other in [env, *others]:
        other.step(np.full((3, 5, 2), 0.3, np.float32))
        expect(other.obs.tobytes() == there, "a copy has gone another way")
    for face in (parallel_env(seed=1), TeamVectorEnv("passage", 2, seed=1), Env("passage", 2, seed=1)):
        for other in (copy.deepcopy(face), pickle.loads(pickle.dumps(face)), pickle.loads(cloudpickle.dumps(face))):
            expect(np.array_equal(other.core.obs, face.core.obs), f"a copy of {type(face).__name__} differs")
    parallel = ParallelEnv(2, Env("passage", 2, episode_s=1.0))
    expect(parallel.rollout(5).batch_size[:2] == (2, 2), "TorchRL does not run two instances")
    parallel.close()
