"""What agents say of themselves, and networks over what was heard. Skipped where TorchRL, VMAS or BenchMARL is missing."""

import copy

import pytest
from needs import need

torch = need("torch")
need("torchrl")
need("vmas")

from torchrl.envs import TransformedEnv  # noqa: E402
from torchrl.envs.libs.vmas import VmasEnv  # noqa: E402
from torchrl.envs.utils import check_env_specs  # noqa: E402

from murmurate.torchrl import Messages, edges_of, positions_of  # noqa: E402


def others(robots):
    """Pairs of a receiver and another one."""
    return [(i, j) for i in range(robots) for j in range(robots) if i != j]


@pytest.mark.parametrize("said", ["observation", positions_of])
@pytest.mark.parametrize("delay_s, steps", [(0.0, 0), (0.12, 2)])
def test_what_is_known_of_agents_is_heard_as_it_was_when_they_said_it(said, delay_s, steps):
    env = TransformedEnv(VmasEnv("navigation", num_envs=3, n_agents=4, seed=0), Messages(said=said, delay_s=delay_s))
    check_env_specs(env)
    assert ("agents", "message") not in env.action_spec.keys(True)
    where = []

    def policy(tensordict):
        where.append(positions_of(env.base_env) if callable(said) else tensordict["agents", said].clone())
        return env.rand_action(tensordict)

    rolled = env.rollout(6, policy)["next", "agents"]
    for step in range(6):
        assert rolled["heard"][:, step].sum() == (36 if step >= steps else 0)
        for i, j in others(4):
            expected = where[step - steps][:, j] if step >= steps else torch.zeros_like(where[0][:, j])
            assert torch.equal(rolled["messages"][:, step, i, j], expected)
            # A step of the channel is 0.05 s.
            age = 0.05 * (steps + 1) if step >= steps else 0.0
            assert torch.allclose(rolled["age"][:, step, i, j], torch.tensor(age))


def test_what_is_known_follows_what_the_policy_says():
    env = TransformedEnv(VmasEnv("navigation", num_envs=2, seed=0), Messages(3, said=positions_of))
    check_env_specs(env)
    rolled = env.rollout(1)
    said = rolled["agents", "message"][:, 0]
    assert said.shape[-1] == 3 and torch.equal(rolled["next", "agents", "messages"][:, 0, 1, 0, :3], said[:, 0])
    base = VmasEnv("navigation", num_envs=2)
    for options, words in (
        ({}, "floats: it is 0"),
        ({"said": "place"}, "said: the group 'agents' has no 'place'"),
        ({"said": lambda env: positions_of(env)[0]}, r"said: its shape is \[4, 2\] and not \[2, 4\]"),
    ):
        with pytest.raises(ValueError, match=words):
            TransformedEnv(base, Messages(**options)).rollout(1)


def test_a_step_without_what_agents_say_is_refused():
    from torchrl.envs import Compose, ExcludeTransform

    base = VmasEnv("navigation", num_envs=2, seed=0)
    env = TransformedEnv(base, Compose(Messages(said="observation"), ExcludeTransform(("agents", "observation"))))
    with pytest.raises(ValueError, match=r"observation: a step has no \('agents', 'observation'\)"):
        env.rollout(2)
    for options, key in (({}, "message"), ({"send_key": "sends"}, "sends")):
        env = TransformedEnv(base, Messages(3, **options))
        acted = env.rand_action(env.reset()).exclude(("agents", key))
        with pytest.raises(ValueError, match=rf"{key}: a step has no \('agents', '{key}'\).*the policy has not written it"):
            env.step(acted)


def test_a_clone_has_a_channel_of_its_own():
    messages = Messages(said=positions_of)
    TransformedEnv(VmasEnv("navigation", num_envs=2, seed=0), messages).rollout(2)
    other = TransformedEnv(VmasEnv("navigation", num_envs=5, seed=0), messages.clone())
    assert other.rollout(2)["next", "agents", "heard"].shape == (5, 2, 4, 4)


def test_edges_are_those_of_what_was_heard():
    heard = torch.zeros(2, 3, 3, dtype=torch.bool)
    heard[0, 0, 2] = heard[1, 1, 0] = heard[1, 2, 1] = True
    assert edges_of(heard).tolist() == [[2, 3, 4], [0, 4, 5]]
    assert edges_of(heard.view(1, 2, 3, 3)).tolist() == edges_of(heard).tolist()
    assert edges_of(torch.zeros(4, 3, 3)).shape == (2, 0)


def made(folder, conv, *, share=True, algorithm=None, **options):
    """Experiment of BenchMARL on ``navigation`` with a graph network over messages."""
    need("benchmarl")
    need("torch_geometric")
    from benchmarl.algorithms import MappoConfig
    from benchmarl.environments import VmasTask
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models import MlpConfig, SequenceModelConfig
    from torch import nn

    from murmurate.benchmarl import HeardGnnConfig, with_messages

    config = ExperimentConfig.get_from_yaml()
    config.loggers, config.create_json, config.render, config.evaluation = [], False, False, False
    config.save_folder, config.max_n_frames, config.share_policy_params = str(folder), 400, share
    config.on_policy_n_envs_per_worker, config.on_policy_collected_frames_per_batch = 8, 400
    config.on_policy_minibatch_size, config.on_policy_n_minibatch_iters = 200, 2
    mlp = MlpConfig(num_cells=[16], activation_class=nn.Tanh, layer_class=nn.Linear)
    heard = HeardGnnConfig(gnn_class=conv, num_cells=(16,))
    return Experiment(
        task=with_messages(VmasTask.NAVIGATION.get_from_yaml(), bytes=104, **options),
        algorithm_config=(algorithm or MappoConfig).get_from_yaml(),
        model_config=SequenceModelConfig(model_configs=[heard, mlp], intermediate_sizes=[16]),
        critic_model_config=mlp, seed=0, config=config,
    )


@pytest.mark.parametrize("conv, share", [("GraphConv", True), ("GATv2Conv", True), ("SAGEConv", False)])
def test_mappo_of_benchmarl_trains_a_graph_network_over_messages(conv, share, tmp_path):
    layers = need("torch_geometric").nn
    options = {"radio": "wifi", "spread_s": 0.05, "range_m": 1.0, "position": positions_of}
    experiment = made(tmp_path, getattr(layers, conv), share=share, **options)
    before = copy.deepcopy([parameter.data for parameter in experiment.policy.parameters()])
    experiment.run()
    assert experiment.total_frames == 400
    assert any(not torch.equal(old, new) for old, new in zip(before, experiment.policy.parameters()))


def test_an_agent_acts_on_what_it_has_heard_alone(tmp_path):
    layers = need("torch_geometric").nn
    experiment = made(tmp_path, layers.GraphConv, loss=0.5)
    network = experiment.policy[0] if hasattr(experiment.policy, "__getitem__") else experiment.policy
    batch = experiment.test_env.reset().select(("agents", "observation"), ("agents", "messages"), ("agents", "heard"), ("agents", "age"))
    n, r = batch["agents"].batch_size
    torch.manual_seed(0)
    batch["agents", "heard"] = torch.rand(n, r, r) < 0.5
    batch["agents", "messages"] = torch.randn(batch["agents", "messages"].shape)
    out = lambda td: network(td.clone())["agents", "logits"]
    first, changed = out(batch), batch.clone()
    floats = batch["agents", "observation"].shape[-1]
    # What agent 1 has said to agent 0 changes.
    changed["agents", "messages"][:, 0, floats : 2 * floats] += 1.0
    differs = (out(changed) != first).any(-1)
    assert torch.equal(differs[:, 0], batch["agents", "heard"][:, 0, 1]) and not differs[:, 1:].any()


def test_what_was_heard_is_encoded_as_by_its_sender(tmp_path):
    layers = need("torch_geometric").nn
    experiment = made(tmp_path, layers.SAGEConv, share=False, loss=0.5)
    network = experiment.policy[0] if hasattr(experiment.policy, "__getitem__") else experiment.policy
    batch = experiment.test_env.reset().select(*[("agents", key) for key in ("observation", "messages", "heard", "age")])
    n, r = batch["agents"].batch_size
    torch.manual_seed(0)
    batch["agents", "heard"] = torch.rand(n, r, r) < 0.5
    batch["agents", "messages"] = torch.randn(batch["agents", "messages"].shape)
    out = lambda: network(batch.clone())["agents", "logits"].detach()
    first = out()
    heard_gnn = next(module for module in network.modules() if hasattr(module, "networks"))
    with torch.no_grad():
        heard_gnn.networks[1][0][0].bias += 1.0
    differs = (out() != first).any(-1)
    expected = batch["agents", "heard"][:, :, 1].clone()
    expected[:, 1] = True
    assert torch.equal(differs, expected), "the encoder of agent 1 matters to itself, and to who has heard it"


def test_tasks_without_messages_are_refused(tmp_path):
    need("benchmarl")
    layers = need("torch_geometric").nn
    with pytest.raises(ValueError, match="agents observe 18 floats and say 2: say 'observation'"):
        made(tmp_path, layers.GraphConv, said=positions_of)
