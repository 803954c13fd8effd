"""Export leaves each module in training or in evaluation as it was."""

import torch
from lib_expect import WORK, expect
from torch import nn
from torch_geometric.nn import GATv2Conv

import murmurate

encoder = nn.Sequential(nn.Linear(6, 32), nn.Tanh(), nn.Dropout(0.5))
hop, decoder = GATv2Conv(32, 16, heads=2, edge_dim=3, dropout=0.5), nn.Linear(32, 4)
for frozen in (encoder, hop, decoder):
    frozen.eval()
x = torch.ones(1, 6)
before = encoder(x)
where = {"like": murmurate.VecEnv("passage"), "edge": ["age", "relative-position"]}
murmurate.export(WORK / "p.safetensors", encoder, [hop, nn.Tanh()], decoder, **where)
expect([module.training for module in (encoder, hop, decoder)] == [False] * 3, "they are in training now")
expect(torch.equal(before, encoder(x)) and torch.equal(encoder(x), encoder(x)), "dropout is on now")
encoder.train()
encoder[2].eval()
murmurate.export(WORK / "p.safetensors", encoder, [hop, nn.Tanh()], decoder, **where)
expect((encoder.training, encoder[2].training, hop.training) == (True, False, False), "a part is no longer as it was")
