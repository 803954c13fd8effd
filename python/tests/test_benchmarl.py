"""Tasks of BenchMARL: IPPO and MAPPO to the end, and their actors exported whole. Skipped where BenchMARL is not installed."""

import json

import pytest
from needs import need

import murmurate

torch = need("torch")
need("benchmarl")
need("torch_geometric")

from benchmarl.algorithms import IppoConfig, MappoConfig  # noqa: E402
from benchmarl.experiment import Experiment, ExperimentConfig  # noqa: E402
from benchmarl.models import GnnConfig, GruConfig, LstmConfig, MlpConfig, SequenceModelConfig  # noqa: E402
from tensordict import TensorDict  # noqa: E402
from tensordict.nn import NormalParamExtractor, TensorDictModule  # noqa: E402
from torch import nn  # noqa: E402
from torch_geometric.nn import (  # noqa: E402
    GATConv,
    GATv2Conv,
    GCNConv,
    GraphConv,
    SAGEConv,
    TAGConv,
    TransformerConv,
)
from torchrl.envs.utils import check_env_specs  # noqa: E402
from torchrl.modules import MultiAgentMLP, ProbabilisticActor, TanhNormal  # noqa: E402

from murmurate import _export  # noqa: E402
from murmurate.benchmarl import Task  # noqa: E402

POSITION = {"position_key": "position", "pos_features": 2, "exclude_pos_from_node_features": True}
VELOCITY = {"velocity_key": "velocity", "vel_features": 2}


def mlp(*cells, activation=nn.Tanh):
    return MlpConfig(num_cells=list(cells), activation_class=activation, layer_class=nn.Linear)


def gnn(conv, *, loops=False, topology="full", edges=(), **arguments):
    return GnnConfig(topology=topology, self_loops=loops, gnn_class=conv, gnn_kwargs=arguments, **dict(edges))


def sequence(*models, sizes):
    return SequenceModelConfig(model_configs=list(models), intermediate_sizes=list(sizes))


def experiment(folder, model, algorithm=IppoConfig, *, edges=False, share=True, rule=(), repeat=2, **options):
    config = ExperimentConfig.get_from_yaml()
    config.loggers, config.create_json, config.render = [], False, False
    config.evaluation, config.evaluation_interval, config.evaluation_episodes = True, 400, 2
    config.save_folder, config.max_n_frames, config.share_policy_params = str(folder), 800, share
    config.on_policy_n_envs_per_worker, config.on_policy_collected_frames_per_batch = 8, 400
    config.on_policy_minibatch_size, config.on_policy_n_minibatch_iters, config.lr = 200, 2, 1e-3
    algorithm = algorithm.get_from_yaml()
    for name, value in dict(rule).items():
        setattr(algorithm, name, value)
    task = Task("passage", edges=edges, repeat=repeat, episode_s=2.0, **options)
    return Experiment(
        task=task, algorithm_config=algorithm, model_config=model, critic_model_config=mlp(16), seed=0, config=config
    )


def noisy(experiment):
    """Biases of convolutions begin as zeros, which would hide mistakes."""
    with torch.no_grad():
        for parameter in experiment.policy.parameters():
            if parameter.dim() == 1:
                parameter.uniform_(-0.5, 0.5)
    return experiment


@pytest.mark.parametrize("algorithm", [IppoConfig, MappoConfig])
@pytest.mark.parametrize("scenario_conditions", ["perfect", "late"])
def test_ippo_and_mappo_train_to_the_end_and_what_they_learnt_is_run(algorithm, scenario_conditions, tmp_path):
    model = sequence(mlp(16), gnn(GraphConv, aggr="add"), mlp(16), sizes=[8, 8])
    trained = experiment(tmp_path, model, algorithm, conditions=scenario_conditions)
    before = [parameter.detach().clone() for parameter in trained.policy.parameters()]
    trained.run()
    assert trained.total_frames == 800
    assert any(not torch.equal(old, new) for old, new in zip(before, trained.policy.parameters()))
    file = murmurate.export(tmp_path / "policy.safetensors", trained)
    results = murmurate.sim("passage", file, mode="onboard-adhoc", episodes=1, repeats=1)
    assert results.episodes == 1 and not list(tmp_path.glob("tmp*"))


CASES = {
    "mlp": (mlp(16, 8), {}),
    "mlp, relu, plain normal": (
        mlp(16, 8, activation=nn.ReLU),
        {"rule": {"use_tanh_normal": False, "scale_mapping": "exp"}},
    ),
    "mlp with edges' keys": (mlp(16), {"edges": True}),
    "graph": (sequence(mlp(16), gnn(GraphConv, aggr="mean"), mlp(16), sizes=[8, 8]), {}),
    "graph alone": (gnn(GraphConv), {}),
    "graph, loops, other bias": (
        sequence(mlp(16), gnn(GraphConv, loops=True), mlp(16), sizes=[8, 8]),
        {"rule": {"scale_mapping": "biased_softplus_0.5"}},
    ),
    "gatv2": (sequence(mlp(16), gnn(GATv2Conv), mlp(16), sizes=[8, 8]), {}),
    "gatv2, edges": (
        sequence(gnn(GATv2Conv, edges=POSITION | VELOCITY), mlp(16), sizes=[8]),
        {"edges": True},
    ),
    "gatv2, edges, position as a feature": (
        sequence(gnn(GATv2Conv, edges=POSITION | {"exclude_pos_from_node_features": False}), mlp(16), sizes=[8]),
        {"edges": True},
    ),
    "transformer, edges, loops": (
        sequence(gnn(TransformerConv, loops=True, edges=POSITION | VELOCITY), mlp(16), sizes=[8]),
        {"edges": True},
    ),
    "two rounds": (
        sequence(gnn(TransformerConv, edges=POSITION), mlp(16), gnn(GraphConv, aggr="max"), mlp(16), sizes=[8, 8, 8]),
        {"edges": True},
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_actors_are_exported_whole(name, tmp_path, monkeypatch):
    model, options = CASES[name]
    made = noisy(experiment(tmp_path, model, **options))
    # Each probe that the program answers: first of the actor itself, then of teams that hear 0, 1 and 4 others.
    probes, finished = [], _export.finished

    def told(words):
        said = finished(words)
        probes.append(json.loads(said)["probe"])
        return said

    monkeypatch.setattr(_export, "finished", told)
    file = murmurate.export(tmp_path / "policy.safetensors", made)
    worst = max(max(probe["latent_difference"], probe["output_difference"]) for probe in probes)
    print(f"{name}: differs by {worst:.1e}")
    assert len(probes) == 2 and worst <= 1e-5
    assert murmurate.sim("passage", file, episodes=1, repeats=1).episodes == 1


@pytest.mark.parametrize(
    "model, options, words",
    [
        (mlp(8), {"share": False}, "a network for each robot"),
        (gnn(GraphConv), {"share": False}, "a network for each robot"),
        (gnn(GraphConv, topology="empty"), {}, "topology 'empty'"),
        (mlp(8, activation=nn.GELU), {}, "GELU"),
        (mlp(8), {"rule": {"scale_mapping": "relu"}}, "scale_mapping"),
        (GruConfig.get_from_yaml(), {}, "Gru"),
    ],
)
def test_what_cannot_be_exported_is_refused_by_name(model, options, words, tmp_path):
    made = experiment(tmp_path, model, **options)
    with pytest.raises(ValueError, match=words):
        murmurate.export(tmp_path / "policy.safetensors", made)
    assert not (tmp_path / "policy.safetensors").exists()


def test_an_actor_of_torchrl_is_exported_whole(tmp_path):
    from murmurate.torchrl import Env

    env = Env("passage", 2)
    network = nn.Sequential(
        MultiAgentMLP(6, 4, 5, centralized=False, share_params=True, num_cells=[16, 16], activation_class=nn.Tanh),
        NormalParamExtractor(),
    )
    keys = [("agents", "loc"), ("agents", "scale")]
    limit = env.core.limit_m_s
    actor = ProbabilisticActor(
        TensorDictModule(network, [("agents", "observation")], keys),
        in_keys=keys, out_keys=[("agents", "action")], distribution_class=TanhNormal,
        distribution_kwargs={"low": -limit, "high": limit}, return_log_prob=True,
    )
    env.rollout(3, actor)
    file = murmurate.export(tmp_path / "policy.safetensors", actor, like=env)
    assert murmurate.sim("passage", file, episodes=1, repeats=1).episodes == 1
    with pytest.raises(ValueError, match="limit"):
        actor[-1].distribution_kwargs["high"] = 2.0
        murmurate.export(file, actor, like=env)


@pytest.mark.parametrize("edges", [False, True])
@pytest.mark.parametrize("scenario, repeat", [("passage", 1), ("swap", 4)])
def test_a_task_makes_environments_that_pass_the_check(scenario, repeat, edges):
    task = Task(scenario, edges=edges, repeat=repeat, episode_s=1.0)
    env = task.get_env_fun(3, True, 1, "cpu")()
    check_env_specs(env)
    rollout = env.rollout(40, break_when_any_done=False)
    assert rollout["next", "done"].sum() >= 3
    # An episode of a second has 20 steps.
    assert rollout["next", "done"][:, 20 // repeat - 1].all() and task.max_steps(env) == 20 // repeat
    if edges:
        seen = rollout["agents"]
        ahead = seen["position"] + seen["velocity"]
        assert torch.allclose(seen["observation"][..., 4:6], ahead, atol=1e-5)


def test_a_held_action_adds_the_rewards_of_its_steps():
    once, held = (Task("passage", repeat=repeat).get_env_fun(4, True, 3, "cpu")() for repeat in (1, 4))
    once.reset(), held.reset()
    action = torch.full((4, 5, 2), 0.3)
    given = lambda: TensorDict({"agents": TensorDict({"action": action.clone()}, (4, 5))}, (4,))
    rewards = [once._step(given())["agents", "reward"] for _ in range(4)]
    assert torch.allclose(sum(rewards), held._step(given())["agents", "reward"], atol=1e-5)
    assert torch.equal(torch.from_numpy(once.core.obs), torch.from_numpy(held.core.obs))


def test_arguments_that_a_task_does_not_take_are_named():
    with pytest.raises(ValueError, match="message"):
        Task("passage", message="observations")
    with pytest.raises(ValueError, match="repeat"):
        Task("passage", repeat=0)
    with pytest.raises(ValueError, match="decoder|hops"):
        murmurate.export("policy.safetensors", nn.Linear(6, 4), [])
    with pytest.raises(ValueError, match="actor"):
        murmurate.export("policy.safetensors", nn.Linear(6, 4), like=murmurate.VecEnv())


GRAPHS = {
    "mlp, layer norm, gelu": (
        MlpConfig(
            num_cells=[16], activation_class=nn.GELU, layer_class=nn.Linear,
            norm_class=nn.LayerNorm, norm_kwargs=[{"normalized_shape": 16}],
        ),
        {},
    ),
    "gat, residual, edges": (
        sequence(gnn(GATConv, residual=True, edges=POSITION | VELOCITY), mlp(16), sizes=[8]),
        {"edges": True},
    ),
    "gcn": (sequence(mlp(16), gnn(GCNConv), mlp(16), sizes=[8, 8]), {"rule": {"use_tanh_normal": False, "scale_mapping": "exp"}}),
    "gcn, loops": (sequence(mlp(16), gnn(GCNConv, loops=True), mlp(16), sizes=[8, 8]), {}),
    "sage": (sequence(mlp(16), gnn(SAGEConv, project=True), mlp(16), sizes=[8, 8]), {}),
    "tag": (sequence(mlp(16), gnn(TAGConv), mlp(16), sizes=[8, 8]), {}),
    "two rounds": CASES["two rounds"],
}  # fmt: skip


@pytest.mark.parametrize("name", GRAPHS)
def test_actors_that_no_policy_file_can_hold_are_exported_whole_as_graphs(name, tmp_path):
    need("onnxscript")
    from graphs import compared

    model, options = GRAPHS[name]
    made = noisy(experiment(tmp_path, model, **options))
    if name != "two rounds":
        with pytest.raises(ValueError, match="; to write it as a graph of format 3, name the file 'p.policy.toml'"):
            murmurate.export(tmp_path / "p.safetensors", made)
    with compared() as found:
        # The actor itself is compared with its parts within, for a team in which all hear each other.
        file = murmurate.export(tmp_path / "p.policy.toml", made)
    assert found[0] <= 2e-6 and murmurate.sim("passage", file, episodes=1, repeats=1).aborted == 0


@pytest.mark.parametrize("config", [GruConfig, LstmConfig])
def test_actors_with_memory_are_graphs_with_a_state(config, tmp_path):
    need("onnxscript")
    import numpy as np
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    from murmurate import _onnx, actors

    cells = {"mlp_num_cells": [16], "mlp_layer_class": nn.Linear, "mlp_activation_class": nn.Tanh}
    made = noisy(experiment(tmp_path, config(hidden_size=16, n_layers=2, bias=True, dropout=0.0, compile=False, **cells)))
    file = murmurate.export_graph(tmp_path / "p.policy.toml", **actors.benchmarl(made))
    assert murmurate.sim("passage", file, episodes=1, repeats=1).aborted == 0
    graph = _onnx.Session((tmp_path / "p.onnx").read_bytes())
    robots, state = 5, None
    hidden = {key: torch.zeros(1, robots, 2, 16) for key in made.policy.in_keys if "_hidden" in str(key)}
    for step in range(200):
        begins = step % 50 == 0
        if begins:
            state = np.zeros((robots, 32 * len(hidden)), np.float32)
        seen = torch.randn(1, robots, 6)
        team = TensorDict({("agents", "observation"): seen, "is_init": torch.full((1, 1), begins)}, batch_size=[1])
        for key, value in hidden.items():
            team.set(key, value)
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            out = made.policy(team)
        hidden = {key: out.get(("next", *key)) for key in hidden}
        goal, position, both = np.split(seen[0].numpy(), 3, axis=1)
        answer = graph.run({"goal-minus-position": goal, "position": position, "velocity": both - position, "state": state})
        state = answer["state_next"]
        assert np.allclose(answer["action"], out["agents", "action"][0].numpy(), atol=1e-5)
