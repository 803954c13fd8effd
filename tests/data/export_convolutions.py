"""Writes policy files of format 2 with graph convolutions of PyTorch Geometric, and what these answer, as probes.

    pip install numpy safetensors torch torch_geometric
    python export_convolutions.py

They are the fixtures of tests/learning/convolutions.rs. The weights are noise. Each function `..._hop` turns one
convolution into a hop: its form for the manifest, and its layers. Written with torch 2.15.0 and torch_geometric 2.8.1.
"""

import hashlib
import json
import math
from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import save_file
from torch import nn
from torch_geometric.nn import GATv2Conv, GINEConv, GraphConv, TransformerConv

FOLDER = Path(__file__).parent
WIDTH, HEADS, EDGE = 8, 2, 6

MANIFEST = {
    "format": 2,
    "scenario": "passage",
    "observation": ["goal-minus-position", "position", "position-plus-velocity"],
    "edge": ["age", "relative-position", "distance", "relative-velocity"],
    "distribution": "tanh-normal",
    "deviation": "biased-softplus",
    "draw": "mean",
    "radius_m": 2.0,
    "rate_hz": 20.0,
    "limit_m_s": 1.5,
    "hold_s": 0.2,
}


def export(path, manifest, networks, probe):
    """`networks` has the layers of each network by its name: pairs of a weight [out, in] and a bias [out]."""
    tensors = {f"probe.{name}": rows for name, rows in probe.items()}
    for name, layers in networks.items():
        for depth, (weight, bias) in enumerate(layers):
            tensors |= {f"{name}.{2 * depth}.weight": weight, f"{name}.{2 * depth}.bias": bias}
    tensors = {name: np.ascontiguousarray(numbers(tensor), dtype=np.float32) for name, tensor in tensors.items()}
    data = b"".join(tensors[name].tobytes() for name in sorted(tensors))
    manifest = {**manifest, "sha256": hashlib.sha256(data).hexdigest()}
    save_file(tensors, path, metadata={"murmurate": json.dumps(manifest)})


def numbers(tensor):
    return tensor.detach().numpy() if isinstance(tensor, torch.Tensor) else np.asarray(tensor)


def beside(*blocks):
    """One matrix for inputs that lie one after the other."""
    return torch.cat(blocks, dim=1)


def graph_conv_hop(conv):
    update = (beside(conv.lin_root.weight, conv.lin_rel.weight), conv.lin_rel.bias)
    form = {
        "aggregation": {"add": "sum"}.get(conv.aggr, conv.aggr),
        "update": {"inputs": ["own", "messages"], "widths": [2 * WIDTH, WIDTH]},
    }
    return form, {"update": [update]}


def gatv2_hop(conv):
    message = (conv.lin_l.weight, conv.lin_l.bias)
    first = beside(conv.lin_r.weight, conv.lin_l.weight, conv.lin_edge.weight)
    # The score of a head takes the values of that head only.
    score = torch.block_diag(*conv.att[0].unsqueeze(1))
    form = {
        "message": {"inputs": ["sender"], "widths": [WIDTH, WIDTH]},
        "aggregation": "softmax",
        "heads": HEADS,
        "score": {
            "inputs": ["own", "sender", "edge"],
            "widths": [2 * WIDTH + EDGE, WIDTH, HEADS],
            "activation": {"leaky-relu": conv.negative_slope},
        },
        "update": {"inputs": ["messages"], "widths": [WIDTH, WIDTH]},
    }
    if conv.add_self_loops:
        form["self_loop"] = "mean-edge"
    networks = {
        "message": [message],
        "score": [(first, conv.lin_r.bias + conv.lin_l.bias), (score, torch.zeros(HEADS))],
        "update": [(torch.eye(WIDTH), conv.bias)],
    }
    return form, networks


def gine_hop(conv):
    message = (beside(torch.eye(WIDTH), conv.lin.weight), conv.lin.bias)
    first, last = conv.nn[0], conv.nn[2]
    form = {
        "message": {"inputs": ["sender", "edge"], "widths": [WIDTH + EDGE, WIDTH], "output_activation": "relu"},
        "aggregation": "sum",
        "update": {"inputs": ["own", "messages"], "widths": [2 * WIDTH, WIDTH, WIDTH], "activation": "elu"},
    }
    update = [(beside((1 + conv.eps) * first.weight, first.weight), first.bias), (last.weight, last.bias)]
    return form, {"message": [message], "update": update}


def transformer_hop(conv):
    edge = conv.lin_edge.weight
    sent = {"inputs": ["sender", "edge"], "widths": [WIDTH + EDGE, WIDTH]}
    form = {
        "message": sent,
        "aggregation": "dot-product",
        "heads": HEADS,
        "query": {"inputs": ["own"], "widths": [WIDTH, WIDTH]},
        "key": sent,
        "update": {"inputs": ["own", "messages"], "widths": [2 * WIDTH, WIDTH]},
    }
    networks = {
        "message": [(beside(conv.lin_value.weight, edge), conv.lin_value.bias)],
        "query": [(conv.lin_query.weight, conv.lin_query.bias)],
        "key": [(beside(conv.lin_key.weight, edge), conv.lin_key.bias)],
        "update": [(beside(conv.lin_skip.weight, torch.eye(WIDTH)), conv.lin_skip.bias)],
    }
    return form, networks


HOPS = {GraphConv: graph_conv_hop, GATv2Conv: gatv2_hop, GINEConv: gine_hop, TransformerConv: transformer_hop}


class Team:
    """Eight robots: one receives no message, one a single message, the others four. Rows receive, columns send."""

    def __init__(self, rng):
        robots = 8
        self.position, self.velocity, self.goal = (
            torch.from_numpy(rng.uniform(-1.5, 1.5, (3, robots, 2)).round(3).astype(np.float32))
        )
        # Whole milliseconds, in which the program counts time here.
        age_ms = rng.integers(0, 200, (robots, robots)).astype(np.float32)
        self.age = torch.from_numpy(age_ms / np.float32(1000.0))
        heard = np.zeros((robots, robots))
        heard[1, 2] = 1
        for robot in range(2, robots):
            others = [other for other in range(robots) if other != robot]
            heard[robot, rng.choice(others, 4, replace=False)] = 1
        self.heard = torch.from_numpy(heard.astype(np.float32))
        receiver, sender = self.heard.nonzero(as_tuple=True)
        self.index = torch.stack([sender, receiver])
        way = self.position[sender] - self.position[receiver]
        rush = self.velocity[sender] - self.velocity[receiver]
        self.edge = torch.cat([self.age[receiver, sender, None], way, way.norm(dim=1, keepdim=True), rush], dim=1)

    def observation(self):
        return torch.cat([self.goal - self.position, self.position, self.position + self.velocity], dim=1)

    def inputs(self):
        return {"position": self.position, "velocity": self.velocity, "goal": self.goal, "age": self.age,
                "heard": self.heard}


def write(name, convolutions, team):
    encoder = nn.Sequential(nn.Linear(6, WIDTH), nn.Tanh(), nn.Linear(WIDTH, WIDTH))
    decoder = nn.Sequential(nn.ReLU(), nn.Linear(WIDTH, 4))
    layers = lambda network: [(part.weight, part.bias) for part in network if isinstance(part, nn.Linear)]
    networks = {"encoder": layers(encoder), "decoder": layers(decoder)}
    hops, sent = [], []
    x = encoder(team.observation())
    for at, conv in enumerate(convolutions):
        sent.append(x)
        x = conv(x, team.index) if isinstance(conv, GraphConv) else conv(x, team.index, team.edge)
        form, parts = HOPS[type(conv)](conv)
        # The decoder begins with an activation: here it follows each hop.
        x = torch.relu(x)
        form["update"]["output_activation"] = "relu"
        hops.append(form)
        networks |= {f"hops.{at}.{part}": layers for part, layers in parts.items()}
    manifest = {
        **MANIFEST,
        "encoder": {"widths": [6, WIDTH, WIDTH], "activation": "tanh"},
        "hops": hops,
        "decoder": {"widths": [WIDTH, 4]},
    }
    probe = {**team.inputs(), "latent": torch.cat(sent, dim=1), "output": decoder(x)}
    export(FOLDER / f"conv_{name}.safetensors", manifest, networks, probe)


def noisy(conv):
    """Biases of convolutions begin as zeros, which would hide mistakes."""
    with torch.no_grad():
        for parameter in conv.parameters():
            if parameter.dim() == 1:
                parameter.uniform_(-0.5, 0.5)
    return conv


def gatv2(self_loops):
    return noisy(GATv2Conv(WIDTH, WIDTH // HEADS, heads=HEADS, edge_dim=EDGE, add_self_loops=self_loops))


def gine():
    network = nn.Sequential(nn.Linear(WIDTH, WIDTH), nn.ELU(), nn.Linear(WIDTH, WIDTH))
    return noisy(GINEConv(network, eps=0.25, edge_dim=EDGE))


def transformer():
    return noisy(TransformerConv(WIDTH, WIDTH // HEADS, heads=HEADS, edge_dim=EDGE))


def main():
    torch.manual_seed(7)
    team = Team(np.random.default_rng(7))
    for aggregation in ("add", "mean", "max"):
        write(f"graph_{aggregation}", [noisy(GraphConv(WIDTH, WIDTH, aggr=aggregation))], team)
    write("gatv2", [gatv2(self_loops=False)], team)
    write("gatv2_self_loops", [gatv2(self_loops=True)], team)
    write("gine", [gine()], team)
    write("transformer", [transformer()], team)
    write("three_hops", [gatv2(self_loops=True), transformer(), gine()], team)


if __name__ == "__main__":
    main()
