"""Trainers of others on the faces, to the end: Stable-Baselines3 by SuperSuit, RLlib, and parallel environments of TorchRL."""

import numpy as np
import pytest
from needs import need


def test_ppo_of_stable_baselines3_learns_on_teams_that_supersuit_copies(tmp_path):
    supersuit = need("supersuit")
    sb3 = need("stable_baselines3")
    from murmurate.pettingzoo import parallel_env

    for num_cpus in (0, 2):
        env = supersuit.pettingzoo_env_to_vec_env_v1(parallel_env("passage", episode_s=1.0))
        env = supersuit.concat_vec_envs_v1(env, 2, num_cpus=num_cpus, base_class="stable_baselines3")
        try:
            first = env.reset()
            assert first.shape == (10, 6) and not np.array_equal(first[:5], first[5:]), "two teams, with layouts of their own"
            if num_cpus == 0:
                model = sb3.PPO("MlpPolicy", env, n_steps=32, batch_size=80, n_epochs=2, device="cpu")
                before = [parameter.detach().clone() for parameter in model.policy.parameters()]
                model.learn(640)
                assert model.num_timesteps >= 640
                assert any((old != new).any() for old, new in zip(before, model.policy.parameters()))
        finally:
            env.close()


def test_ppo_of_stable_baselines3_learns_on_the_single_environment():
    sb3 = need("stable_baselines3")
    gymnasium = need("gymnasium")
    from stable_baselines3.common.env_checker import check_env

    env = gymnasium.make("murmurate.gymnasium:murmurate/Passage-v0", episode_s=1.0)
    check_env(env.unwrapped)
    model = sb3.PPO("MlpPolicy", env, n_steps=40, batch_size=40, n_epochs=1, device="cpu").learn(80)
    assert model.num_timesteps == 80


def test_two_runners_of_rllib_have_layouts_of_their_own_and_ppo_learns(monkeypatch):
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    ray = need("ray")
    need("ray.rllib")
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
    from ray.tune import register_env

    def make(_):
        from murmurate.pettingzoo import parallel_env

        return ParallelPettingZooEnv(parallel_env("passage", episode_s=1.0))

    register_env("murmurate", make)
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, object_store_memory=200 * 2**20)
    try:
        config = PPOConfig().environment("murmurate").env_runners(num_env_runners=2, rollout_fragment_length=40)
        config = config.training(train_batch_size_per_learner=80, minibatch_size=40, num_epochs=1)
        config = config.multi_agent(policies={"p"}, policy_mapping_fn=lambda *_, **__: "p")
        algorithm = config.build_algo()

        def first(runner):
            episodes = runner.sample(num_episodes=2, random_actions=True)
            return [episode.agent_episodes["robot_0"].get_observations(0).tolist() for episode in episodes]

        one, other = algorithm.env_runner_group.foreach_env_runner(first, local_env_runner=False)
        assert one[0] != other[0] and one[1] != other[1], "they would see the same"
        assert algorithm.train()["training_iteration"] == 1
        algorithm.stop()
    finally:
        ray.shutdown()


@pytest.mark.parametrize("parallel", ["SerialEnv", "ParallelEnv"])
@pytest.mark.parametrize("as_instance", [True, False])
def test_environments_of_torchrl_run_in_parallel_as_instances_and_as_functions(parallel, as_instance):
    torch = need("torch")
    need("torchrl")
    import torchrl.envs

    from murmurate.torchrl import Env

    given = Env("passage", 2, episode_s=1.0) if as_instance else lambda: Env("passage", 2, episode_s=1.0)
    env = getattr(torchrl.envs, parallel)(2, given)
    try:
        seen = env.reset()["agents", "observation"]
        assert seen.shape == (2, 2, 5, 6) and not torch.equal(seen[0], seen[1]), "workers with data of their own"
        rollout = env.rollout(30, break_when_any_done=False)
        assert rollout["next", "done"].sum() >= 4
        env.set_seed(5)
        seen = env.reset()["agents", "observation"]
        assert not torch.equal(seen[0], seen[1])
        env.set_seed(5)
        assert torch.equal(env.reset()["agents", "observation"], seen)
    finally:
        env.close()


def test_an_evaluation_of_benchmarl_lasts_as_long_as_the_configuration_says(tmp_path):
    need("benchmarl")
    from murmurate import _program
    from murmurate.benchmarl import Task

    file = tmp_path / "long.toml"
    words = ["train", "passage", "--print-config", "--preset", "published", "--set", "episode_s=40.0", "--robots", "4"]
    file.write_text(_program.finished(words))
    task = Task("passage", config=file, penalties=1)
    env = task.get_env_fun(2, True, 1, "cpu")()
    assert task.max_steps(env) == 800 and env.core.num_robots == 4
    assert Task("passage").max_steps(None) == 300, "that of the preset"
    assert Task("passage", config=file, penalties=1, repeat=3).max_steps(None) == 267
    assert Task("passage", config=file, stage=-1).max_steps(None) == 800 // task_repeat(file)
    assert Task("flocking").max_steps(None) == 200
    for seconds in (0.35, 1.15, 15.1, 5.1):
        env = Task("passage", episode_s=seconds).get_env_fun(1, True, 1, "cpu")()
        steps = Task("passage", episode_s=seconds).max_steps(env)
        rollout = env.rollout(steps + 5)
        assert rollout.shape[1] <= steps and (rollout["next", "terminated"].any() or rollout.shape[1] == steps), seconds


def task_repeat(file):
    """Number of steps for which the last stage of a configuration holds an action."""
    from murmurate import VecEnv

    return VecEnv(config=file, stage=-1).repeat
