"""What export cannot write is a ValueError that names the argument."""

import torch
from lib_expect import WORK, expect, refused
from torch import nn
from torch_geometric.nn import GATv2Conv

import murmurate
from murmurate.gymnasium import TeamVectorEnv
from murmurate.pettingzoo import parallel_env

FILE = WORK / "p.safetensors"


def conv():
    return GATv2Conv(32, 16, heads=2, edge_dim=3)


def export(**other):
    parts = {"encoder": nn.Linear(6, 32), "hops": [conv()], "decoder": nn.Linear(32, 4), "edge": ["age", "relative-position"]}
    return murmurate.export(FILE, **{**parts, "like": murmurate.VecEnv("passage"), **other})


for other, words in (
    ({"encoder": nn.Linear(6, 32).double()}, "encoder: Linear: 'weight' is torch.float64"),
    ({"encoder": nn.Linear(6, 32).half()}, "encoder: Linear: 'weight' is torch.float16"),
    ({"hops": [conv().bfloat16()]}, "hops[0]: GATv2Conv"),
    ({"encoder": nn.Linear(4, 32)}, "encoder: Linear: its first layer takes 4 floats, and an observation has 6"),
    ({"encoder": nn.LazyLinear(32)}, "encoder: LazyLinear: 'weight' has no size yet"),
    ({"hops": conv()}, "hops: a GATv2Conv is no list"),
    ({"hops": [conv(), torch.tanh]}, "hops[1]: tanh is no module"),
    ({"edge": "age"}, "edge: 'age' is a text"),
    ({"distribution": "beta"}, "distribution: 'beta' is none of diagonal-normal, tanh-normal"),
    ({"deviation": "beta"}, "deviation: 'beta' is none of"),
    ({"draw": "beta"}, "draw: 'beta' is none of"),
    ({"hold_s": float("nan")}, "hold_s: nan"),
    ({"encoder": nn.Linear(6, 32).to("meta")}, "encoder: Linear: 'weight' is on the device 'meta'"),
    ({"like": object()}, "like: object is neither a VecEnv nor"),
):
    refused(lambda other=other: export(**other), ValueError, words)
expect(not list(WORK.iterdir()), "a refused export leaves a file")
for like in (TeamVectorEnv("passage", 2), parallel_env("passage")):
    expect(export(like=like) == FILE, f"like={type(like).__name__} is not taken")
