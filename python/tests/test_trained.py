"""Models of trainers as policies, as they are: by the snippets of docs/python-policies.md, against what the model says there."""

import numpy as np
import pytest
from needs import need

import murmurate


def seen_by(act):
    """Notes what a function is asked and answers, with the number of robots of each call."""
    calls = []

    def noted(seen):
        answer = act(seen)
        calls.append((seen.copy(), np.asarray(answer).copy()))
        return answer

    return noted, calls


def runs(policy, calls, **flags):
    results = murmurate.sim("passage", policy, robots=3, episodes=1, repeats=1, **flags)
    assert results.episodes == 1
    asked = calls[-1][0]
    assert len(calls) > 20 and asked.shape == (3, 6) and asked.dtype == np.float32 and np.isfinite(asked).all()


def test_a_function_gets_the_observations_of_the_environment():
    env = murmurate.VecEnv("passage", 1, num_robots=3)
    act, calls = seen_by(lambda seen: np.clip(seen[:, 0:2], -0.5, 0.5))
    policy = murmurate.trained(act, env, name="straight")
    runs(policy, calls)
    assert env.observation_fields == ["goal-minus-position", "position", "position-plus-velocity"]
    assert list(policy.contract["observation"]) == ["goal-minus-position", "position", "velocity"]
    # The first calls are those of the check.
    begin, later = calls[-15][0], calls[-1][0]
    # The third entry is the sum of position and velocity, and the first two that of a goal which stays where it is.
    assert np.abs(begin[:, 0:2] + begin[:, 2:4] - later[:, 0:2] - later[:, 2:4]).max() < 1e-4
    assert np.abs(later[:, 4:6] - later[:, 2:4]).max() < 1.0


def test_what_is_no_environment_of_a_training_is_refused():
    with pytest.raises(ValueError, match="like: int is neither a VecEnv"):
        murmurate.trained(lambda seen: seen, 3)


def test_a_model_of_stable_baselines3():
    sb3, supersuit = need("stable_baselines3"), need("supersuit")
    from murmurate.pettingzoo import parallel_env

    env = parallel_env("passage", num_robots=3)
    teams = supersuit.concat_vec_envs_v1(
        supersuit.pettingzoo_env_to_vec_env_v1(env), 1, base_class="stable_baselines3"
    )
    model = sb3.PPO("MlpPolicy", teams, n_steps=8, device="cpu")
    act, calls = seen_by(lambda seen: model.predict(seen, deterministic=True)[0])
    runs(murmurate.trained(act, like=env), calls)
    assert np.array_equal(calls[-1][1], model.predict(calls[-1][0], deterministic=True)[0])


def actor_of_torchrl(torch, floats, limit):
    from tensordict.nn import TensorDictModule
    from torchrl.modules import MLP, NormalParamExtractor, ProbabilisticActor, TanhNormal

    torch.manual_seed(3)
    network = torch.nn.Sequential(MLP(floats, 4, num_cells=[16]), NormalParamExtractor())
    keys = [("agents", "loc"), ("agents", "scale")]
    return ProbabilisticActor(
        TensorDictModule(network, [("agents", "observation")], keys),
        in_keys=keys,
        out_keys=[("agents", "action")],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -limit, "high": limit},
    )


def test_an_actor_of_torchrl():
    need("torchrl")
    import torch
    from tensordict import TensorDict
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    from murmurate.torchrl import Env

    env = Env("passage", 2, num_robots=3)
    actor = actor_of_torchrl(torch, env.core.obs.shape[2], env.core.limit_m_s)

    def act(seen):
        team = TensorDict({"agents": {"observation": torch.from_numpy(seen)[None]}}, (1,))
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            return actor(team)["agents", "action"][0]

    noted, calls = seen_by(act)
    runs(murmurate.trained(noted, like=env), calls)


def test_a_policy_of_benchmarl(tmp_path):
    need("benchmarl")
    import torch
    from tensordict import TensorDict
    from test_benchmarl import experiment, mlp
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    trained = experiment(tmp_path, mlp(16))
    env = murmurate.VecEnv("passage", 1, num_robots=3)

    def act(seen):
        # Its network takes the number of robots of the training: empty rows follow.
        rows = torch.zeros(5, seen.shape[1])
        rows[: len(seen)] = torch.from_numpy(seen)
        team = TensorDict({"agents": {"observation": rows[None]}}, (1,))
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            return trained.policy(team)["agents", "action"][0, : len(seen)]

    noted, calls = seen_by(act)
    runs(murmurate.trained(noted, like=env), calls)


def test_a_module_of_rllib():
    need("ray.rllib")
    import gymnasium
    import torch
    from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule

    env = murmurate.VecEnv("passage", 1, num_robots=3)
    floats, limit = env.obs.shape[2], env.limit_m_s
    module = DefaultPPOTorchRLModule(
        observation_space=gymnasium.spaces.Box(-np.inf, np.inf, (floats,)),
        action_space=gymnasium.spaces.Box(-limit, limit, (2,)),
        model_config={"fcnet_hiddens": [16]},
    )

    def act(seen):
        with torch.no_grad():
            logits = module.forward_inference({"obs": torch.from_numpy(seen)})["action_dist_inputs"]
        return limit * logits.chunk(2, 1)[0].clamp(-1, 1)

    noted, calls = seen_by(act)
    runs(murmurate.trained(noted, like=env), calls)
