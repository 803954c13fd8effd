"""The faces for other tools, by those tools' own checks. Each is skipped where its tool is not installed."""

import numpy as np
import pytest


def test_pettingzoo():
    pytest.importorskip("pettingzoo")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    from murmurate.pettingzoo import parallel_env

    parallel_api_test(parallel_env(episode_s=2.0), num_cycles=500)
    parallel_seed_test(lambda: parallel_env(conditions="late"), num_cycles=200)


def test_gymnasium():
    pytest.importorskip("gymnasium")
    from gymnasium.vector import AutoresetMode
    from gymnasium.wrappers.vector import RecordEpisodeStatistics

    from murmurate.gymnasium import TeamVectorEnv

    env = TeamVectorEnv("passage", 8, episode_s=1.0, conditions="robust")
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    first, _ = env.reset(seed=4)
    assert first in env.observation_space and first.dtype == np.float32
    again, _ = env.reset(seed=4)
    assert np.array_equal(first, again)
    env.action_space.seed(1)
    for step in range(1, 21):
        obs, reward, terminated, truncated, infos = env.step(env.action_space.sample())
        assert obs in env.observation_space and reward.shape == terminated.shape == (8,)
        assert truncated.all() == (step == 20)
    assert infos["_final_obs"].all() and not np.array_equal(infos["final_obs"], obs)
    counted = RecordEpisodeStatistics(TeamVectorEnv("passage", 4, episode_s=1.0))
    counted.reset(seed=0)
    infos = [counted.step(counted.action_space.sample())[-1] for _ in range(20)][-1]
    assert (infos["episode"]["l"] == 20).all()
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=[1, 2])


@pytest.mark.parametrize("message", [None, "observations", "action"])
@pytest.mark.parametrize("conditions", ["perfect", "late"])
def test_torchrl(message, conditions):
    pytest.importorskip("torchrl")
    from torchrl.envs.utils import check_env_specs

    from murmurate.torchrl import Env

    env = Env("passage", 3, conditions=conditions, message=message, episode_s=1.0)
    check_env_specs(env)
    rollout = env.rollout(50, break_when_any_done=False)
    assert rollout["next", "done"].sum() >= 3 and not rollout["agents", "observation"].isnan().any()
