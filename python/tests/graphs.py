"""Policies of format 3 from PyTorch modules, one for each kind, and the largest difference between each and its graph.

    python python/tests/graphs.py          # a table; needs torch, torch_geometric, onnx, onnxscript and onnxruntime
"""

import contextlib
import pathlib
import sys
import tempfile

import torch
from torch import nn

import murmurate
from murmurate import _engine, _parity

#: Features of an edge in the order of the modules here, and their number of floats.
EDGES, EDGE_FLOATS = ["relative-position", "relative-velocity", "age"], 5
WIDTH = 16


def attend(query, keys, values, heard):
    """Softmax over the neighbours that are heard; zeros without any."""
    score = (keys @ query.unsqueeze(2)).squeeze(2) / query.shape[1] ** 0.5
    weight = score.clamp(-30, 30).exp() * heard
    return ((weight / (weight.sum(1, keepdim=True) + 1e-6)).unsqueeze(1) @ values).squeeze(1)


class Recurrent(nn.Module):
    """A GRU cell, attention over what is heard, and layer normalisation, in one graph."""

    def __init__(self):
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(4, WIDTH), nn.GELU(), nn.LayerNorm(WIDTH))
        self.cell, self.say = nn.GRUCell(WIDTH, WIDTH), nn.Linear(WIDTH, 8)
        self.key, self.value = nn.Linear(8 + EDGE_FLOATS, WIDTH), nn.Linear(8 + EDGE_FLOATS, WIDTH)
        self.head = nn.Sequential(nn.LayerNorm(2 * WIDTH), nn.Linear(2 * WIDTH, 2), nn.Tanh())

    def forward(self, goal, velocity, messages, edges, heard, state):
        state = self.cell(self.encoder(torch.cat([goal, velocity], 1)), state)
        both = torch.cat([messages, edges], 2)
        action = self.head(torch.cat([state, attend(state, self.key(both), self.value(both), heard)], 1))
        return action, self.say(state), state


class Lstm(nn.Module):
    """An LSTM cell, whose hidden state and cell are one state."""

    state_floats = 2 * WIDTH

    def __init__(self):
        super().__init__()
        self.cell, self.head = nn.LSTMCell(4 + EDGE_FLOATS, WIDTH), nn.Linear(WIDTH, 4)

    def forward(self, goal, velocity, edges, heard, state):
        heard = heard.unsqueeze(2)
        near = (edges * heard).sum(1) / heard.sum(1).clamp(min=1.0)
        hidden, cell = self.cell(torch.cat([goal, velocity, near], 1), state.chunk(2, 1))
        return self.head(hidden), torch.cat([hidden, cell], 1)


class Layers(nn.Module):
    """The layer nn.GRU with two levels, for one step."""

    state_floats = 2 * WIDTH

    def __init__(self):
        super().__init__()
        self.gru, self.head = nn.GRU(4, WIDTH, num_layers=2, batch_first=True), nn.Linear(WIDTH, 2)

    def forward(self, goal, velocity, state):
        before = state.unflatten(1, (2, WIDTH)).transpose(0, 1).contiguous()
        out, after = self.gru(torch.cat([goal, velocity], 1).unsqueeze(1), before)
        return self.head(out[:, 0]), after.transpose(0, 1).flatten(1)


class LstmLayer(nn.Module):
    """The layer nn.LSTM, for one step."""

    state_floats = 2 * WIDTH

    def __init__(self):
        super().__init__()
        self.lstm, self.head = nn.LSTM(6, WIDTH, batch_first=True), nn.Linear(WIDTH, 2)

    def forward(self, observation, state):
        hidden, cell = state.unsqueeze(0).chunk(2, 2)
        out, (hidden, cell) = self.lstm(observation.unsqueeze(1), (hidden.contiguous(), cell.contiguous()))
        return self.head(out[:, 0]), torch.cat([hidden[0], cell[0]], 1)


class Say(nn.Module):
    """Message of the step: the encoder's output."""

    def __init__(self):
        super().__init__()
        self.net = nn.Sequential(nn.Linear(4, WIDTH), nn.SiLU(), nn.LayerNorm(WIDTH))

    def forward(self, goal, velocity):
        return self.net(torch.cat([goal, velocity], 1))


class Multihead(nn.Module):
    """nn.MultiheadAttention over the robot itself and what it hears, so that a place is always there."""

    def __init__(self):
        super().__init__()
        self.attention = nn.MultiheadAttention(WIDTH, 4, batch_first=True)
        self.head = nn.Linear(WIDTH, 2)

    def forward(self, own_message, messages, heard):
        all_of_them = torch.cat([own_message.unsqueeze(1), messages], 1)
        absent = torch.cat([torch.zeros_like(heard[:, :1]), 1.0 - heard], 1) > 0.5
        out, _ = self.attention(all_of_them[:, :1], all_of_them, all_of_them, key_padding_mask=absent)
        return self.head(out[:, 0]).tanh()


def mlp(takes, gives=2):
    return nn.Sequential(nn.Linear(takes, 32), nn.ELU(), nn.Linear(32, gives))


OBSERVED = ["goal-minus-position", "position", "velocity"]
SCALE = ([0.5, -0.2, 0.1, 3.0, 0.0, 1.0], [2.0, 1.0, 0.3, 5.0, 1.0, 0.5], 5.0)
GIVEN = {"goal": "goal-minus-position"}
SENT = {"edges": EDGES, "sign": "theirs-minus-own"}

#: Arguments of ``export_graph`` for each policy.
MODULES = {
    "feed-forward": lambda: {"step": mlp(6), "observations": OBSERVED},
    "normalised, 4 frames": lambda: {"step": mlp(24, 4), "observations": OBSERVED, "normalize": SCALE, "stack": 4, "stack_start": "first"},
    "GRU cell, attention, layer norm": lambda: {"step": Recurrent(), "observations": GIVEN, "message": 8, "state": WIDTH, **SENT},
    "LSTM cell": lambda: {"step": Lstm(), "observations": GIVEN, **SENT},
    "nn.GRU, 2 layers": lambda: {"step": Layers(), "observations": GIVEN},
    "nn.LSTM": lambda: {"step": LstmLayer(), "observations": OBSERVED},
    "nn.MultiheadAttention": lambda: {"encode": Say(), "act": Multihead(), "observations": GIVEN},
    "5 choices": lambda: {
        "step": mlp(6, 5), "observations": OBSERVED, "limit": None, "action": "choice",
        "choices": [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]],
    },
}  # fmt: skip


def convolutions():
    """Hops for each convolution, and the features of edges that it takes."""
    import torch_geometric.nn as geometric

    two = lambda takes: nn.Sequential(nn.Linear(takes, WIDTH), nn.GELU(), nn.Linear(WIDTH, WIDTH))  # noqa: E731
    edge = ["age", "relative-position", "distance", "relative-velocity"]
    return {
        "EdgeConv": ([geometric.EdgeConv(two(2 * WIDTH))], []),
        "GATConv": ([geometric.GATConv(WIDTH, 4, heads=4, edge_dim=6, residual=True), nn.ELU()], edge),
        "GATv2Conv": ([geometric.GATv2Conv(WIDTH, WIDTH, heads=2, edge_dim=6, concat=False), nn.SiLU()], edge),
        "GCNConv": ([geometric.GCNConv(WIDTH, WIDTH), nn.LayerNorm(WIDTH), nn.Tanh()], []),
        "GINConv": ([geometric.GINConv(two(WIDTH), eps=0.2)], []),
        "GINEConv": ([geometric.GINEConv(two(WIDTH), edge_dim=6)], edge),
        "GraphConv": ([geometric.GraphConv(WIDTH, WIDTH, aggr="mean"), nn.GELU()], []),
        "SAGEConv": ([geometric.SAGEConv(WIDTH, WIDTH, aggr="max", project=True, normalize=True)], []),
        "TAGConv": ([geometric.TAGConv(WIDTH, WIDTH, K=3)], []),
        "TransformerConv": ([geometric.TransformerConv(WIDTH, 8, heads=2, edge_dim=6, beta=True)], edge),
        "GCNConv, TAGConv, GATConv": (
            [geometric.GCNConv(WIDTH, WIDTH), nn.Tanh(), geometric.TAGConv(WIDTH, 8, K=2), geometric.GATConv(8, WIDTH, edge_dim=6)],
            edge,
        ),
    }


def noisy(modules):
    """Biases of convolutions begin as zeros, which would hide mistakes."""
    with torch.no_grad():
        for module in modules:
            for parameter in module.parameters():
                if parameter.dim() == 1:
                    parameter.uniform_(-0.5, 0.5)
    return modules


def exported(name, folder):
    """Exports one of these policies, and returns its contract."""
    torch.manual_seed(3)
    file = pathlib.Path(folder) / "p.policy.toml"
    if name in MODULES:
        return murmurate.export_graph(file, **{"limit": 1.0, **MODULES[name]()})
    hops, edge = convolutions()[name]
    parts = nn.Sequential(nn.Linear(6, WIDTH), nn.GELU()), noisy(hops), nn.Linear(WIDTH, 4)
    return murmurate.export(file, *parts, like=murmurate.VecEnv("passage"), edge=edge)


class Found(list):
    """Largest differences of exports, and the graphs and samples of the last of them."""

    graphs, samples = {}, []

    def in_the_program(self):
        """Smallest of some bounds that the program's engine keeps, too."""
        bounds = (1e-7, 2e-7, 3e-7, 5e-7, 1e-6, 2e-6, 5e-6, 1e-5)
        return next(bound for bound in bounds if _engine.differing(self.graphs, self.samples, bound) is None)


@contextlib.contextmanager
def compared(steps=1000):
    """Lets exports within the block compare over so many steps. Yields a list that gets the largest difference of each."""
    found, compare = Found(), _parity.compare

    def longer(modules, graphs, contract):
        worst, found.samples = compare(modules, graphs, contract, steps)
        found.graphs = graphs
        found.append(max(worst.values()))
        return worst, found.samples

    _parity.compare = longer
    try:
        yield found
    finally:
        _parity.compare = compare


def measured(name, folder):
    """Exports one of these policies, and returns its contract and the largest difference of any output in 1000 steps."""
    with compared() as found:
        file = exported(name, folder)
    return file, found[0]


def main():
    for name in sys.argv[1:] or [*MODULES, *convolutions()]:
        with tempfile.TemporaryDirectory() as folder:
            with compared() as found:
                file = exported(name, folder)
            results = murmurate.sim("swap", file, episodes=4, repeats=1)
            ran = f"{results.episodes} episodes, {results.aborted} aborted"
            print(f"| {name} | {found[0]:.1e} | {found.in_the_program():.0e} | {ran} |", flush=True)


if __name__ == "__main__":
    main()
