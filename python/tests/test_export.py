"""Export of modules: parity with PyTorch and PyTorch Geometric, a run of the file, and refusals by name."""

import copy
import json
import pathlib

import pytest
from needs import need

import murmurate
from murmurate._program import finished

torch = need("torch")
geometric = need("torch_geometric.nn")
nn = torch.nn
WIDTH, EDGE = 8, ["age", "relative-position", "distance", "relative-velocity"]


def encoder(last=()):
    return nn.Sequential(nn.Linear(6, 16), nn.Tanh(), nn.Linear(16, WIDTH), *last)


def decoder(out=4):
    return nn.Sequential(nn.Linear(WIDTH, WIDTH), nn.ReLU(), nn.Linear(WIDTH, out))


def noisy(module):
    """Biases of convolutions begin as zeros, which would hide mistakes."""
    with torch.no_grad():
        for parameter in module.parameters():
            if parameter.dim() == 1:
                parameter.uniform_(-0.5, 0.5)
    return module


def gine():
    return geometric.GINEConv(nn.Sequential(nn.Linear(WIDTH, 5), nn.ELU(), nn.Linear(5, WIDTH)), eps=0.3, edge_dim=6)


def edge_conv(**options):
    return geometric.EdgeConv(nn.Sequential(nn.Linear(2 * WIDTH, 5), nn.ELU(), nn.Linear(5, WIDTH)), **options)


CASES = {
    "add": (lambda: [geometric.GraphConv(WIDTH, WIDTH, aggr="add"), nn.ReLU()], []),
    "mean": (lambda: [geometric.GraphConv(WIDTH, WIDTH, aggr="mean"), nn.Tanh()], []),
    "max, no bias": (lambda: [geometric.GraphConv(WIDTH, WIDTH, aggr="max", bias=False), nn.ELU()], []),
    "gatv2": (lambda: [geometric.GATv2Conv(WIDTH, 4, heads=2, edge_dim=6, add_self_loops=False)], EDGE),
    "gatv2, loops": (lambda: [geometric.GATv2Conv(WIDTH, 4, heads=2, edge_dim=6), nn.LeakyReLU(0.1)], EDGE),
    "gatv2, no edges": (lambda: [geometric.GATv2Conv(WIDTH, WIDTH, share_weights=True)], []),
    "gat": (lambda: [geometric.GATConv(WIDTH, 4, heads=2, edge_dim=6, add_self_loops=False)], EDGE),
    "gat, loops": (lambda: [geometric.GATConv(WIDTH, 4, heads=2, edge_dim=6), nn.LeakyReLU(0.1)], EDGE),
    "gat, no edges": (lambda: [geometric.GATConv(WIDTH, WIDTH), nn.Linear(WIDTH, WIDTH)], []),
    "sage": (lambda: [geometric.SAGEConv(WIDTH, WIDTH), nn.ReLU()], []),
    "sage, max, no root": (lambda: [geometric.SAGEConv(WIDTH, WIDTH, aggr="max", root_weight=False)], []),
    "edge": (lambda: [edge_conv(), nn.Tanh()], []),
    "edge, sum": (lambda: [edge_conv(aggr="add")], []),
    "gine": (lambda: [gine(), nn.ReLU()], EDGE),
    "transformer": (lambda: [geometric.TransformerConv(WIDTH, 4, heads=2, edge_dim=6), nn.ReLU()], EDGE),
    "transformer, no edges": (lambda: [geometric.TransformerConv(WIDTH, WIDTH, dropout=0.5)], []),
    "three": (
        lambda: [
            geometric.GATv2Conv(WIDTH, 4, heads=2, edge_dim=6),
            nn.Tanh(),
            geometric.TransformerConv(WIDTH, WIDTH, edge_dim=6),
            gine(),
        ],
        EDGE,
    ),
    "nobody": (list, []),
}


@pytest.mark.parametrize("name", CASES)
def test_convolutions_are_written_exactly_and_run(name, tmp_path):
    torch.manual_seed(3)
    make, edge = CASES[name]
    hops = [noisy(part) for part in make()]
    file = tmp_path / "policy.safetensors"
    env = murmurate.VecEnv("passage")
    distribution = {"distribution": "tanh-normal", "deviation": "biased-softplus"} if name == "three" else {}
    # The check of the probe is within; a wrong file raises.
    assert murmurate.export(file, encoder(), hops, decoder(), like=env, edge=edge, **distribution) == file
    results = murmurate.sim("passage", file, mode="onboard-adhoc", episodes=1, repeats=1)
    assert results.episodes == 1 and sorted(path.name for path in tmp_path.iterdir()) == ["policy.safetensors"]


def test_a_decoder_without_deviations_is_written(tmp_path):
    env = murmurate.VecEnv("passage")
    murmurate.export(tmp_path / "p.safetensors", nn.Linear(6, WIDTH), [], decoder(2), like=env)


def test_an_answer_that_differs_leaves_no_file(tmp_path, monkeypatch):
    from murmurate import _hops

    hop_of = _hops._graph_conv

    def wrong(*arguments):
        form, layers = hop_of(*arguments)
        weight, bias = layers["update"][0]
        return form, {"update": [(weight, bias + 1e-3)]}

    monkeypatch.setattr(_hops, "_graph_conv", wrong)
    with pytest.raises(ValueError, match="differ"):
        hops = [geometric.GraphConv(WIDTH, WIDTH)]
        murmurate.export(tmp_path / "p.safetensors", encoder(), hops, decoder(), like=murmurate.VecEnv())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "parts, words",
    [
        ({"hops": [geometric.GCNConv(WIDTH, WIDTH)]}, r"hops\[0\]: GCNConv: it is none of GraphConv"),
        ({"hops": [geometric.GraphConv(WIDTH, WIDTH, aggr="min")]}, "aggregation 'min'"),
        ({"hops": [geometric.TransformerConv(WIDTH, WIDTH, beta=True)]}, "TransformerConv: .* beta=True"),
        ({"hops": [geometric.GATv2Conv(WIDTH, WIDTH, heads=2, concat=False)]}, "GATv2Conv: .* concat=False"),
        ({"hops": [geometric.GATConv(WIDTH, WIDTH, residual=True)]}, "GATConv: .* residual=True; .* name the file 'p.policy.toml'"),
        ({"hops": [geometric.SAGEConv(WIDTH, WIDTH, normalize=True)]}, "SAGEConv: .* normalize=True"),
        ({"hops": [geometric.EdgeConv(nn.Linear(5, WIDTH))]}, r"hops\[0\].nn: Linear: it takes 5 floats, and both robots have 16"),
        ({"hops": [geometric.GATv2Conv(WIDTH, WIDTH, edge_dim=6)]}, "takes 6 features of an edge, and 'edge' has 0"),
        ({"hops": [nn.ReLU(), geometric.GraphConv(WIDTH, WIDTH)]}, "before the first convolution"),
        ({"encoder": nn.Sequential(nn.Linear(6, WIDTH), nn.GELU())}, "encoder: GELU"),
        ({"encoder": nn.Sequential(nn.Linear(6, WIDTH), nn.LayerNorm(WIDTH))}, "encoder: LayerNorm"),
        ({"decoder": nn.Sequential(nn.ReLU(), nn.Linear(WIDTH, 4))}, "decoder: ReLU: an activation that does not follow"),
        ({"decoder": nn.Linear(WIDTH, 5)}, "4|outputs"),
        ({"edge": ["mass"]}, "edge: 'mass'"),
        ({"edge": "age"}, "edge: 'age' is a text; give a list"),
        ({"edge": 3}, "edge: a int is no list"),
        ({"edge": [3]}, "edge: 3 is none of"),
        ({"encoder": encoder().double()}, r"encoder: Sequential: '0.weight' is torch.float64, .* export encoder.float\(\)"),
        ({"decoder": decoder().half()}, r"decoder: Sequential: '0.weight' is torch.float16"),
        ({"hops": [geometric.GraphConv(WIDTH, WIDTH).bfloat16()]}, r"hops\[0\]: GraphConv: .* is torch.bfloat16"),
        ({"encoder": nn.Linear(4, WIDTH)}, r"encoder: Linear: its first layer takes 4 floats, and an observation has 6 \(goal-minus"),
        ({"decoder": nn.Linear(WIDTH + 1, 4)}, r"decoder: Linear: its first layer takes 9 floats, and what is before it gives 8"),
        ({"decoder": nn.Linear(WIDTH, 3)}, "decoder: Linear: it has 3 outputs; give 2"),
        ({"hops": [geometric.GraphConv(16, WIDTH)]}, r"hops\[0\]: GraphConv: it takes 16 floats of a robot, .* gives 8"),
        ({"hops": [geometric.GINEConv(nn.Linear(5, WIDTH), edge_dim=6)], "edge": EDGE}, r"hops\[0\].nn: Linear: it takes 5"),
        ({"hops": [geometric.GraphConv(WIDTH, WIDTH), nn.Linear(5, WIDTH)]}, r"hops\[1\]: "),
        ({"encoder": nn.LazyLinear(WIDTH)}, "encoder: LazyLinear: 'weight' has no size yet; run the module once"),
        ({"hops": [geometric.GraphConv(-1, WIDTH)]}, r"hops\[0\]: GraphConv: .* has no size yet"),
        ({"hops": geometric.GraphConv(WIDTH, WIDTH)}, r"hops: a GraphConv is no list; give \[GraphConv\(...\)\]"),
        ({"hops": [geometric.GraphConv(WIDTH, WIDTH), torch.tanh]}, r"hops\[1\]: tanh is no module of PyTorch"),
        ({"hops": 5}, "hops: a int is no list"),
        ({"encoder": torch.tanh}, "encoder: tanh is no module"),
        ({"decoder": encoder().state_dict()}, "decoder: OrderedDict is no module"),
        ({"encoder": nn.Linear(6, WIDTH, device="meta")}, "encoder: Linear: 'weight' is on the device 'meta'"),
        ({"distribution": "beta"}, "distribution: 'beta' is none of diagonal-normal, tanh-normal"),
        ({"deviation": "softplus"}, "deviation: 'softplus' is none of log"),
        ({"draw": "median"}, "draw: 'median' is none of mean, sample"),
        ({"draw": None}, "draw: None is none of"),
        ({"hold_s": float("nan")}, "hold_s: nan is no time"),
        ({"hold_s": "long"}, "hold_s: 'long' is no time"),
        ({"hold_s": -0.2}, "hold_s: -0.2 is not 0.05 to 60"),
        ({"hold_s": 100}, "hold_s: 100 is not 0.05 to 60"),
        ({"scenario": "pasage"}, "scenario: .*pasage"),
        ({"like": None}, "like: missing; give the environment"),
        ({"like": "passage"}, "like: str is neither a VecEnv nor"),
        ({"hops": None, "decoder": None}, "policy: Sequential is no actor"),
    ],
)
def test_what_cannot_be_written_is_refused_by_name(parts, words, tmp_path):
    given = {"encoder": encoder(), "hops": [], "decoder": decoder(), "like": murmurate.VecEnv(), **parts}
    with pytest.raises(ValueError, match=words):
        murmurate.export(tmp_path / "p.safetensors", **given)
    assert not list(tmp_path.iterdir())


def manifest(file):
    return json.loads(finished(["policy", "check", str(file), "--json"]))["manifest"]


def test_the_scenario_and_the_hold_time_are_those_of_the_environment(tmp_path):
    swap, file = murmurate.VecEnv("swap"), tmp_path / "p.safetensors"
    murmurate.export(file, nn.Linear(6, 8), [], nn.Linear(8, 4), like=swap)
    assert (manifest(file)["scenario"], manifest(file)["hold_s"]) == ("swap", swap.hold_s) == ("swap", 0.4)
    assert murmurate.sim("swap", file, episodes=1, repeats=1).episodes == 1
    with pytest.raises(ValueError, match="swap"):
        murmurate.sim("passage", file, episodes=1, repeats=1)
    murmurate.export(file, nn.Linear(6, 8), [], nn.Linear(8, 4), like=swap, scenario="passage", hold_s=0.3)
    assert (manifest(file)["scenario"], manifest(file)["hold_s"]) == ("passage", 0.3)
    published = murmurate.VecEnv("passage", config="published")
    murmurate.export(file, nn.Linear(6, 8), [], nn.Linear(8, 4), like=published)
    assert manifest(file)["hold_s"] == published.hold_s != 0.4
    flock = murmurate.VecEnv("flocking", num_robots=20)
    murmurate.export(file, nn.Linear(4, 8), [], nn.Linear(8, 4), like=flock)
    assert manifest(file)["scenario"] == "flocking" and manifest(file)["observation"] == ["position", "velocity"]


def test_each_module_is_in_training_or_evaluation_afterwards_as_it_was_before(tmp_path):
    def parts():
        made = nn.Sequential(nn.Linear(6, 16), nn.Tanh(), nn.Dropout(0.5)), geometric.GATv2Conv(16, 8, dropout=0.5), nn.Linear(8, 4)
        return nn.ModuleList(made)

    modes = (lambda m: m.eval(), lambda m: m.train(), lambda m: (m.train(), m[0][2].eval()), lambda m: (m.eval(), m[1].train()))
    for mode in modes:
        whole = parts()
        mode(whole)
        before = [module.training for module in whole.modules()]
        murmurate.export(tmp_path / "p.safetensors", whole[0], [whole[1], nn.Tanh()], whole[2], like=murmurate.VecEnv())
        assert [module.training for module in whole.modules()] == before
        with pytest.raises(ValueError):
            murmurate.export(tmp_path / "q.safetensors", whole[0], [whole[1]], nn.Linear(5, 4), like=murmurate.VecEnv())
        assert [module.training for module in whole.modules()] == before, "after a refusal, too"


def test_faces_and_harmless_wrappers_are_taken_and_others_are_refused_by_name(tmp_path):
    need("gymnasium")
    need("pettingzoo")
    from gymnasium.wrappers import RescaleAction, TransformReward
    from gymnasium.wrappers.vector import NormalizeObservation, NormalizeReward, RecordEpisodeStatistics, RescaleAction as Rescaled

    from murmurate.gymnasium import TeamEnv, TeamVectorEnv
    from murmurate.pettingzoo import parallel_env

    def exported(like):
        return murmurate.export(tmp_path / "p.safetensors", encoder(), [], decoder(), like=like)

    vector = lambda: TeamVectorEnv("passage", 2, autoreset="next-step")  # noqa: E731
    harmless = [vector(), TeamEnv(), parallel_env(), RecordEpisodeStatistics(vector()), NormalizeReward(vector())]
    for like in [*harmless, TransformReward(TeamEnv(), float)]:
        assert exported(like).exists()
    wrong = [
        ("NormalizeObservation", NormalizeObservation(vector())),
        ("RescaleAction", RescaleAction(TeamEnv(), -1.0, 1.0)),
        # Below one that is harmless.
        ("RescaleAction", NormalizeReward(Rescaled(vector(), -1.0, 1.0))),
    ]
    for name, like in wrong:
        with pytest.raises(ValueError, match=f"like: {name}.* it may change what the policy observes or commands; put that"):
            exported(like)


def test_a_folder_that_is_not_there_is_named_and_no_temporary_one(tmp_path):
    parts = nn.Linear(6, 8), [], nn.Linear(8, 4)
    env = murmurate.VecEnv()
    for file, words in (
        (tmp_path / "nowhere" / "p.safetensors", "file: there is no folder '.*nowhere'"),
        (tmp_path, "file: '.*' is a folder"),
        (5, "file: a int is no path"),
    ):
        with pytest.raises(ValueError, match=words):
            murmurate.export(file, *parts, like=env)
    # What only the program finds names the file that was asked for.
    wide = nn.Linear(6, 300), [geometric.GraphConv(300, 8)], nn.Linear(8, 4)
    with pytest.raises(ValueError) as error:
        murmurate.export(tmp_path / "mine.safetensors", *wide, like=env)
    assert "tmp" not in str(error.value).replace(str(tmp_path), "") and not list(tmp_path.iterdir())


def test_relative_paths_and_modules_on_another_device_are_taken(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert murmurate.export("p.safetensors", encoder(), [], decoder(), like=murmurate.VecEnv()) == pathlib.Path("p.safetensors")
    if torch.cuda.is_available():
        there = encoder().cuda(), [geometric.GraphConv(WIDTH, WIDTH).cuda()], decoder().cuda()
        murmurate.export("q.safetensors", *there, like=murmurate.VecEnv())
        assert next(there[0].parameters()).is_cuda


def actor_and_env():
    from tensordict.nn import NormalParamExtractor, TensorDictModule
    from torchrl.modules import MultiAgentMLP, ProbabilisticActor, TanhNormal

    from murmurate.torchrl import Env

    base = Env("passage", 2, seed=1)
    network = nn.Sequential(
        MultiAgentMLP(6, 4, 5, centralized=False, share_params=True, num_cells=[16], activation_class=nn.Tanh),
        NormalParamExtractor(),
    )
    keys, limit = [("agents", "loc"), ("agents", "scale")], base.core.limit_m_s
    return base, ProbabilisticActor(
        TensorDictModule(network, [("agents", "observation")], keys),
        in_keys=keys, out_keys=[("agents", "action")], distribution_class=TanhNormal,
        distribution_kwargs={"low": -limit, "high": limit},
    )  # fmt: skip


def wanted(file, observation):
    """What the policy of a file wants of observations, computed from the tensors of the file, without messages."""
    data = pathlib.Path(file).read_bytes()
    length = int.from_bytes(data[:8], "little")
    header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
    told = json.loads(header.pop("__metadata__")["murmurate"])

    def tensor(name):
        begin, end = header[name]["data_offsets"]
        return torch.frombuffer(bytearray(body[begin:end]), dtype=torch.float32).reshape(header[name]["shape"])

    x = observation
    for network, form in (("encoder", told["encoder"]), ("decoder", told["decoder"])):
        depth = len(form["widths"]) - 1
        for layer in range(depth):
            x = x @ tensor(f"{network}.{2 * layer}.weight").T + tensor(f"{network}.{2 * layer}.bias")
            if layer < depth - 1 or "output_activation" in form:
                x = x.tanh()
    return x[..., :2]


def test_what_normalises_observations_in_training_is_folded_into_the_first_layer(tmp_path):
    need("torchrl")
    from torchrl.envs import ObservationNorm, RewardSum, StepCounter, TransformedEnv
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    key, file = ("agents", "observation"), tmp_path / "p.safetensors"
    norms = (
        {"loc": torch.zeros(6), "scale": torch.full((6,), 0.1)},
        {"loc": torch.linspace(-1, 2, 6), "scale": torch.linspace(0.5, 3, 6), "standard_normal": True},
    )
    for norm in norms:
        base, actor = actor_and_env()
        env = TransformedEnv(base, ObservationNorm(in_keys=[key], **norm))
        env.append_transform(RewardSum(in_keys=[("agents", "reward")]))
        env.append_transform(StepCounter())
        assert murmurate.export(file, actor, like=env) == file
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            trained = actor(env.reset())["agents", "action"]
        limit = base.core.limit_m_s
        there = limit * wanted(file, torch.from_numpy(base.core.obs.copy())).tanh()
        assert torch.allclose(there, trained, atol=1e-5) and not torch.allclose(there, torch.zeros(1))
        # Parts are folded as a whole actor is.
        parts = nn.Sequential(nn.Linear(6, 8), nn.Tanh()), [], nn.Linear(8, 4)
        weights = copy.deepcopy([part.state_dict() for part in (parts[0], parts[2])])
        murmurate.export(file, *parts, like=env)
        observed = env.reset()[key]
        with torch.no_grad():
            expected = parts[2](parts[0](observed))[..., :2]
        assert torch.allclose(wanted(file, torch.from_numpy(base.core.obs.copy())), expected, atol=1e-5)
        after = [part.state_dict() for part in (parts[0], parts[2])]
        assert all(torch.equal(old[name], new[name]) for old, new in zip(weights, after) for name in old), "the modules are as before"


def test_other_transforms_that_change_what_a_policy_observes_or_commands_are_refused_by_name(tmp_path):
    need("torchrl")
    from torchrl.envs import (
        CatFrames, ClipTransform, Compose, DoubleToFloat, ObservationNorm, SerialEnv, TransformedEnv, VecNormV2,
    )  # fmt: skip

    key = ("agents", "observation")
    base, actor = actor_and_env()
    wrong = {
        "VecNormV2": VecNormV2(in_keys=[key], out_keys=[key]),
        "CatFrames": CatFrames(4, dim=-1, in_keys=[key]),
        "ClipTransform": Compose(ClipTransform(in_keys=[key], low=-1.0, high=1.0)),
        "DoubleToFloat": DoubleToFloat(in_keys_inv=[("agents", "action")]),
    }
    for name, transform in wrong.items():
        env = TransformedEnv(actor_and_env()[0], transform)
        with pytest.raises(ValueError, match=f"^like: {name}: it changes what the policy (observes|commands); put that into"):
            murmurate.export(tmp_path / "p.safetensors", actor, like=env)
    each = ObservationNorm(loc=torch.rand(5, 6), scale=torch.ones(5, 6), in_keys=[key])
    with pytest.raises(ValueError, match="like: ObservationNorm: it is another one for each robot"):
        murmurate.export(tmp_path / "p.safetensors", actor, like=TransformedEnv(base, each))
    with pytest.raises(ValueError, match="like: SerialEnv is neither .*; give one environment of a batch"):
        from murmurate.torchrl import Env

        murmurate.export(tmp_path / "p.safetensors", actor, like=SerialEnv(2, lambda: Env("passage", 2)))
    assert not list(tmp_path.iterdir())


def test_a_whole_actor_is_in_training_or_evaluation_afterwards_as_it_was_before(tmp_path):
    need("torchrl")
    base, actor = actor_and_env()
    for mode in (actor.eval, actor.train):
        mode()
        before = [module.training for module in actor.modules()]
        murmurate.export(tmp_path / "p.safetensors", actor, like=base)
        assert [module.training for module in actor.modules()] == before
    with pytest.raises(ValueError, match="policy: .* is torch.float64"):
        murmurate.export(tmp_path / "p.safetensors", actor.double(), like=base)
