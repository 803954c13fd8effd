"""Workers of TorchRL and runners of RLlib have episodes of their own if nobody gives a seed."""

import logging
import os
import warnings

import torch
from lib_expect import expect
from torchrl.envs import ParallelEnv, SerialEnv

import murmurate
from murmurate.torchrl import Env


def make(_=None):
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv

    from murmurate.pettingzoo import parallel_env

    return ParallelPettingZooEnv(parallel_env("passage", episode_s=1.0))


def runners(seed):
    """First observations of robot 0 in two episodes of each of two runners."""
    from ray.rllib.algorithms.ppo import PPOConfig

    config = PPOConfig().environment("m").env_runners(num_env_runners=2, rollout_fragment_length=40).debugging(seed=seed)
    config = config.training(train_batch_size_per_learner=80, minibatch_size=40, num_epochs=1)
    algorithm = config.multi_agent(policies={"p"}, policy_mapping_fn=lambda *_, **__: "p").build_algo()

    def first(runner):
        episodes = runner.sample(num_episodes=2, random_actions=True)
        return [episode.agent_episodes["robot_0"].get_observations(0).tolist() for episode in episodes]

    seen = algorithm.env_runner_group.foreach_env_runner(first, local_env_runner=False)
    algorithm.stop()
    return seen


if __name__ == "__main__":
    for kind in (SerialEnv, ParallelEnv):
        env = kind(2, lambda: Env("passage", 2))
        seen = env.reset()["agents", "observation"]
        expect(not torch.equal(seen[0], seen[1]), f"the workers of {kind.__name__} see the same")
        env.close()
    one, other = murmurate.VecEnv(seed=None), murmurate.VecEnv(seed=None)
    expect(one.seed != other.seed and (one.obs != other.obs).any(), "seed=None is always the same")
    warnings.filterwarnings("ignore")
    logging.disable(logging.WARNING)
    os.environ["RAY_AUTH_MODE"] = "disabled"
    import ray
    from ray.tune import register_env

    register_env("m", make)
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, object_store_memory=200 * 2**20)
    for seed in (None, 3):
        one, other = runners(seed)
        expect(one[0] != other[0] and one[1] != other[1], f"both runners of RLlib see the same, with seed {seed}")
    ray.shutdown()
