"""Export of modules: parity with PyTorch and PyTorch Geometric, a run of the file, and refusals by name."""

import pytest

import murmurate

torch = pytest.importorskip("torch")
geometric = pytest.importorskip("torch_geometric.nn")
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


CASES = {
    "add": (lambda: [geometric.GraphConv(WIDTH, WIDTH, aggr="add"), nn.ReLU()], []),
    "mean": (lambda: [geometric.GraphConv(WIDTH, WIDTH, aggr="mean"), nn.Tanh()], []),
    "max, no bias": (lambda: [geometric.GraphConv(WIDTH, WIDTH, aggr="max", bias=False), nn.ELU()], []),
    "gatv2": (lambda: [geometric.GATv2Conv(WIDTH, 4, heads=2, edge_dim=6, add_self_loops=False)], EDGE),
    "gatv2, loops": (lambda: [geometric.GATv2Conv(WIDTH, 4, heads=2, edge_dim=6), nn.LeakyReLU(0.1)], EDGE),
    "gatv2, no edges": (lambda: [geometric.GATv2Conv(WIDTH, WIDTH, share_weights=True)], []),
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
        ({"hops": [geometric.GATv2Conv(WIDTH, WIDTH, edge_dim=6)]}, "takes 6 features of an edge, and 'edge' has 0"),
        ({"hops": [nn.ReLU(), geometric.GraphConv(WIDTH, WIDTH)]}, "before the first convolution"),
        ({"encoder": nn.Sequential(nn.Linear(6, WIDTH), nn.GELU())}, "encoder: GELU"),
        ({"encoder": nn.Sequential(nn.Linear(6, WIDTH), nn.LayerNorm(WIDTH))}, "encoder: LayerNorm"),
        ({"decoder": nn.Sequential(nn.ReLU(), nn.Linear(WIDTH, 4))}, "decoder: ReLU: an activation that does not follow"),
        ({"decoder": nn.Linear(WIDTH, 5)}, "4|outputs"),
        ({"edge": ["mass"]}, "edge: 'mass'"),
    ],
)
def test_what_cannot_be_written_is_refused_by_name(parts, words, tmp_path):
    given = {"encoder": encoder(), "hops": [], "decoder": decoder(), "like": murmurate.VecEnv(), **parts}
    with pytest.raises(ValueError, match=words):
        murmurate.export(tmp_path / "p.safetensors", **given)
    assert not list(tmp_path.iterdir())
