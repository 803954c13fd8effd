"""What an actor learnt on normalised observations wants in its environment, its file wants on the same state."""

import json

import torch
from lib_expect import WORK, expect, refused
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.envs import CatFrames, ObservationNorm, TransformedEnv, VecNormV2
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import MultiAgentMLP, ProbabilisticActor, TanhNormal

import murmurate
from murmurate.torchrl import Env

KEY = ("agents", "observation")
torch.manual_seed(0)


def actor(floats=6, limit=Env("passage").core.limit_m_s):
    net = MultiAgentMLP(floats, 4, 5, centralized=False, share_params=True, num_cells=[16], activation_class=nn.Tanh)
    keys = [("agents", "loc"), ("agents", "scale")]
    return ProbabilisticActor(
        TensorDictModule(nn.Sequential(net, NormalParamExtractor()), [KEY], keys), in_keys=keys,
        out_keys=[("agents", "action")], distribution_class=TanhNormal, distribution_kwargs={"low": -limit, "high": limit},
    )  # fmt: skip


def of_file(file, x):
    """What the networks of a policy file without messages want of an observation."""
    data = file.read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    forms = json.loads(header["__metadata__"]["murmurate"])
    for network in ("encoder", "decoder"):
        for layer in range(len(forms[network]["widths"]) - 1):
            if layer:
                x = x.tanh()
            for kind in ("weight", "bias"):
                entry = header[f"{network}.{2 * layer}.{kind}"]
                begin, end = (8 + length + offset for offset in entry["data_offsets"])
                numbers = torch.frombuffer(bytearray(data[begin:end]), dtype=torch.float32).reshape(entry["shape"])
                x = x @ numbers.T if kind == "weight" else x + numbers
    return forms["limit_m_s"] * x[..., :2].tanh()


for norm in ({"loc": torch.zeros(6), "scale": torch.full((6,), 0.1)},
             {"loc": torch.full((6,), 3.0), "scale": torch.full((6,), 10.0), "standard_normal": True}):  # fmt: skip
    base, learnt = Env("passage", 2, seed=1), actor()
    env = TransformedEnv(base, ObservationNorm(in_keys=[KEY], **norm))
    file = murmurate.export(WORK / "p.safetensors", learnt, like=env)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        trained = learnt(env.reset())["agents", "action"]
    there = of_file(file, torch.from_numpy(base.core.obs.copy()))
    expect(torch.allclose(trained, there, atol=1e-5), f"in training {trained[0, 0].tolist()}, of the file {there[0, 0].tolist()}")
for name, transform in {
    "VecNormV2": VecNormV2(in_keys=[KEY], out_keys=[KEY]),
    "CatFrames": CatFrames(4, dim=-1, in_keys=[KEY]),
}.items():
    env = TransformedEnv(Env("passage", 2), transform)
    floats = 24 if name == "CatFrames" else 6
    refused(lambda: murmurate.export(WORK / "q.safetensors", actor(floats), like=env), ValueError, f"like: {name}: it changes what")
