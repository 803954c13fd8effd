"""Actors of Stable-Baselines3, TorchRL and RLlib as graphs, against what their trainers answer. Skipped where they are absent."""

import math
import pathlib

import numpy as np
import pytest
from needs import need

import murmurate
from murmurate import _onnx

torch = need("torch")
need("torch_geometric")
need("onnx")
need("onnxscript")
from graphs import compared  # noqa: E402

nn = torch.nn
CHOICES = [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]


def channels(observation):
    """Channels of rows of the training's observation: goal - position, position, position + velocity."""
    goal, position, sum_of_both = np.split(np.asarray(observation, np.float32), 3, axis=1)
    return {"goal-minus-position": goal, "position": position, "velocity": sum_of_both - position}


def session(file):
    return _onnx.Session(pathlib.Path(str(file).replace(".policy.toml", ".onnx")).read_bytes())


def one_robot(choices=None):
    """Environment of one robot with made-up observations, as SuperSuit makes one of each robot of a team."""
    gym = need("gymnasium")

    class One(gym.Env):
        observation_space = gym.spaces.Box(-np.inf, np.inf, (6,), np.float32)
        action_space = gym.spaces.Box(-0.9, 0.9, (2,), np.float32) if choices is None else gym.spaces.Discrete(choices)
        rng = np.random.default_rng(0)

        def seen(self):
            return self.rng.normal(0.5, 2.0, 6).astype(np.float32)

        def reset(self, *, seed=None, options=None):
            return self.seen(), {}

        def step(self, action):
            return self.seen(), 0.0, False, bool(self.rng.random() < 0.05), {}

    return One()


MODELS = {
    "PPO": ("PPO", [], None),
    "PPO, normalised": ("PPO", ["normalize"], None),
    "PPO, normalised frames": ("PPO", ["normalize", "stack"], None),
    "PPO, frames normalised": ("PPO", ["stack", "normalize"], None),
    "PPO, choices": ("PPO", [], 5),
    "A2C": ("A2C", [], None),
    "SAC, normalised": ("SAC", ["normalize"], None),
    "TD3": ("TD3", [], None),
    "DQN": ("DQN", [], 5),
}


@pytest.mark.parametrize("name", MODELS)
def test_models_of_stable_baselines3_answer_as_they_predict(name, tmp_path):
    sb3 = need("stable_baselines3")
    from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

    from murmurate import actors

    kind, wrappers, choices = MODELS[name]
    raw = DummyVecEnv([lambda: one_robot(choices)])
    env = raw
    for wrapper in wrappers:
        env = VecNormalize(env) if wrapper == "normalize" else VecFrameStack(env, 3)
    options = {"PPO": {"n_steps": 64}, "SAC": {"learning_starts": 20}, "TD3": {"learning_starts": 20}}.get(kind, {})
    model = getattr(sb3, kind)("MlpPolicy", env, device="cpu", **options).learn(100)
    with compared() as found:
        arguments = actors.sb3(model) | ({} if choices is None else {"choices": CHOICES})
        file = murmurate.export_graph(tmp_path / "p.policy.toml", **arguments, like=murmurate.VecEnv("passage"))
    assert found[0] <= 2e-6 and murmurate.sim("passage", file, episodes=1, repeats=1).aborted == 0
    wrapped = env
    while wrapped is not raw:
        wrapped.training, wrapped = False, wrapped.venv
    graph, seen = session(file), env.reset()
    start = {"state": np.zeros((1, 12), np.float32)} if "stack" in wrappers else {}
    state = start
    for _ in range(200):
        answer = graph.run(channels(raw.buf_obs[None]) | state)
        expected, _ = model.predict(seen, deterministic=True)
        if choices is None:
            assert np.allclose(np.clip(answer["action"][:, :2], -0.9, 0.9), expected, atol=1e-5)
        else:
            assert answer["action"].argmax(1) == expected
        seen, _, done, _ = env.step(expected)
        state = start if done[0] or not start else {"state": answer["state_next"]}


def test_a_model_of_a_whole_team_or_with_other_actions_is_refused_by_name(tmp_path):
    sb3 = need("stable_baselines3")
    from murmurate import actors
    from murmurate.gymnasium import TeamEnv

    with pytest.raises(ValueError, match="^model: ActorCriticPolicy: its actions Box.* are not two numbers of one robot"):
        actors.sb3(sb3.PPO("MlpPolicy", TeamEnv(), device="cpu"))
    with pytest.raises(ValueError, match="^model: .* no diagonal normal one"):
        actors.sb3(sb3.PPO("MlpPolicy", one_robot(), use_sde=True, device="cpu"))
    sb3.PPO("MlpPolicy", one_robot(), device="cpu").save(tmp_path / "ppo.zip")
    with pytest.raises(ValueError, match="^env: the model has none; give that of the training"):
        actors.sb3(sb3.PPO.load(tmp_path / "ppo.zip", device="cpu"))
    with pytest.raises(ValueError, match="^choices: give one velocity"):
        model = sb3.DQN("MlpPolicy", one_robot(5), device="cpu")
        murmurate.export_graph(tmp_path / "p.policy.toml", **actors.sb3(model), like=murmurate.VecEnv("passage"))


@pytest.mark.parametrize("name", ["TanhNormal", "IndependentNormal", "OneHotCategorical"])
def test_actors_of_torchrl_answer_as_their_distributions(name, tmp_path):
    modules = need("torchrl.modules")
    from tensordict import TensorDict
    from tensordict.nn import NormalParamExtractor, TensorDictModule

    from murmurate import actors

    torch.manual_seed(0)
    normal = name != "OneHotCategorical"
    layers = [nn.Linear(6, 16), nn.LayerNorm(16), nn.SiLU(), nn.Linear(16, 4 if normal else 5)]
    keys = ["loc", "scale"] if normal else ["logits"]
    network = nn.Sequential(*layers, *([NormalParamExtractor()] if normal else []))
    actor = modules.ProbabilisticActor(
        TensorDictModule(network, ["observation"], keys), in_keys=keys, distribution_class=getattr(modules, name),
        distribution_kwargs={"low": -0.9, "high": 0.9} if name == "TanhNormal" else {},
    )  # fmt: skip
    more = {} if normal else {"choices": CHOICES}
    file = murmurate.export_graph(
        tmp_path / "p.policy.toml", **{"limit": 0.9, **actors.torchrl(actor), **more}, like=murmurate.VecEnv("passage")
    )
    seen = torch.randn(16, 6)
    with torch.no_grad():
        of_actor = actor.get_dist(TensorDict({"observation": seen}, batch_size=[16]))
        expected = of_actor.deterministic_sample
        if name == "IndependentNormal":
            expected = torch.cat([of_actor.base_dist.loc, of_actor.base_dist.scale.log()], dim=1)
    answer = session(file).run(channels(seen.numpy()))["action"]
    if normal:
        assert np.allclose(answer, expected.numpy(), atol=1e-5)
    else:
        assert (answer.argmax(1) == expected.float().argmax(1).numpy()).all()


def test_an_actor_of_rllib_is_a_module_of_ten_lines(tmp_path):
    need("ray.rllib")
    from ray.rllib.algorithms.ppo.torch.default_ppo_torch_rl_module import DefaultPPOTorchRLModule

    env, limit = one_robot(), 0.9
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space}
    module = DefaultPPOTorchRLModule(**spaces, model_config={"vf_share_layers": False})

    class Actor(nn.Module):
        def __init__(self):
            super().__init__()
            self.encoder, self.pi = module.encoder.actor_encoder, module.pi

        def forward(self, observation):
            mean, log_std = self.pi(self.encoder({"obs": observation})["encoder_out"]).chunk(2, 1)
            return torch.cat([limit * mean, log_std + math.log(limit)], 1)

    file = murmurate.export_graph(tmp_path / "p.policy.toml", Actor(), like=murmurate.VecEnv("passage"), limit=limit)
    seen = torch.randn(16, 6)
    with torch.no_grad():
        mean, _ = module.forward_inference({"obs": seen})["action_dist_inputs"].chunk(2, 1)
    assert np.allclose(session(file).run(channels(seen.numpy()))["action"][:, :2], limit * mean.numpy(), atol=1e-5)
