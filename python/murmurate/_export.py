"""Export of policies from PyTorch and PyTorch Geometric to policy files of format 2."""

from __future__ import annotations

import hashlib
import json
import os
import pathlib
import tempfile
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ._actors import SOFTPLUS_BIAS, Actor, actor_of
from ._hops import ACTIVATIONS, Refused, activation_of, edges_of, followed, hop_of, network_of
from ._module import VecEnv
from ._program import finished

if TYPE_CHECKING:
    from torch import Tensor, nn

#: Largest difference between what PyTorch and the program compute for the robots of the probe.
TOLERANCE = 1e-5
#: Number of floats of each feature of an edge: of the pair of a message's sender and receiver.
EDGE_WIDTHS = {"age": 1, "relative-position": 2, "distance": 1, "relative-velocity": 2}
#: Log standard deviation of a policy whose decoder has the velocity alone.
LOG_STD = -2.0


def export(
    file: str | os.PathLike[str],
    encoder: Any,
    hops: Sequence[nn.Module] | None = None,
    decoder: nn.Module | None = None,
    *,
    like: Any = None,
    scenario: str | None = None,
    edge: Sequence[str] = (),
    distribution: Literal["diagonal-normal", "tanh-normal"] = "diagonal-normal",
    deviation: Literal["log", "biased-softplus"] = "log",
    draw: Literal["mean", "sample"] = "mean",
    hold_s: float = 0.2,
) -> pathlib.Path:
    """Writes a policy of PyTorch modules to a policy file, for ``sim``, ``study`` and robots.

    The policy is ``decoder(hops(encoder(observation)))``. The file holds the outputs of the modules for eight robots, of
    which one receives no message, one receives one and the others four. The program computes them again from the file;
    without agreement within 1e-5 there is no file.

    Without ``hops`` and ``decoder`` the second argument is a whole actor of BenchMARL or TorchRL, which is taken apart. It must
    itself agree within 1e-5 with the program, for a team in which every robot receives the messages of all others.

    Args:
        file: File to write, or to replace.
        encoder: ``Linear`` layers with one kind of activation between them, in a ``Sequential``; its input is ``obs``. Or a
            whole actor: an ``Experiment`` of BenchMARL or its policy, whose models are ``Mlp`` and ``Gnn`` with the topology
            "full", or a ``ProbabilisticActor`` of TorchRL. ``edge``, ``distribution`` and ``deviation`` are then its own.
        hops: Convolutions of PyTorch Geometric (``GraphConv``, ``GATv2Conv``, ``GINEConv``, ``TransformerConv``), each
            followed by an activation or a network if there is one. Empty for a policy without messages.
        decoder: As the encoder; its outputs are the velocity along x and y [m/s], policy frame, and the parameters of
            their standard deviations. With two outputs alone these are constant.
        like: Environment in which the policy was trained, a :class:`murmurate.VecEnv` or :class:`murmurate.torchrl.Env`: it
            has the observation, the radius [m] and the limit of speed [m/s]. For an ``Experiment`` that of its task.
        scenario: Task of that environment; "passage", or that of the ``Experiment``.
        edge: Features of an edge in the order in which convolutions take them: "age" [s], "relative-position" [m],
            "distance" [m], "relative-velocity" [m/s]; those of the sender minus those of the receiver.
        distribution: Distribution of actions; "tanh-normal" is the limit of speed times tanh of a normal one.
        deviation: What the decoder's last two outputs are: log standard deviations, or TorchRL's "biased_softplus_1.0".
        draw: Whether deployed robots take the mean or draw a sample.
        hold_s: Longest time for which a neighbour's message is used [s].

    Raises:
        ValueError: A module cannot be written to such a file, by name; or the program's answers differ.
    """
    import torch

    unknown = [name for name in edge if name not in EDGE_WIDTHS]
    if unknown:
        raise ValueError(f"edge: '{unknown[0]}' is none of {', '.join(EDGE_WIDTHS)}")
    if (hops is None) != (decoder is None):
        raise ValueError(f"{'hops' if hops is None else 'decoder'}: give encoder, hops and decoder, or a whole actor alone")
    if hops is None and hasattr(encoder, "task"):
        like = encoder.task.environment() if like is None else like
        scenario = scenario or encoder.task.name
    like = getattr(like, "core", like)
    if not isinstance(like, VecEnv):
        raise ValueError(f"like: {type(like).__name__} is neither a VecEnv nor an environment that has one")
    fields, limit_m_s = like.observation_fields, like.limit_m_s
    manifest = {"scenario": scenario or "passage", "observation": fields, "draw": draw, "hold_s": hold_s, "rate_hz": 20.0}
    manifest |= {"distribution": distribution, "deviation": deviation}
    manifest |= {"radius_m": round(like.radius_m, 6), "limit_m_s": round(limit_m_s, 6)}
    try:
        actor = actor_of(encoder, fields, limit_m_s) if hops is None else Actor(encoder, list(hops), decoder, edge=list(edge))
        manifest |= actor.manifest | {"edge": actor.edge}
        modules = torch.nn.ModuleList([actor.encoder, *actor.hops, actor.decoder])
        training = modules.training
        modules.eval()
        try:
            with torch.no_grad():
                written = [_written(actor, _Team(fields, actor.edge))]
                if actor.whole is not None:
                    everybody = _Team(fields, actor.edge, like.num_robots)
                    written.insert(0, _asked(actor, _written(actor, everybody), everybody, manifest))
        finally:
            modules.train(training)
    except Refused as refused:
        raise ValueError(str(refused)) from None
    path = pathlib.Path(file)
    with tempfile.TemporaryDirectory(dir=path.absolute().parent) as folder:
        whole = pathlib.Path(folder) / "policy.safetensors"
        for tensors, form in written:
            whole.write_bytes(_safetensors(tensors, manifest | form))
            probe = json.loads(finished(["policy", "check", str(whole), "--json"]))["probe"]
            worst = max(probe["latent_difference"], probe["output_difference"])
            if not worst <= TOLERANCE:
                raise ValueError(f"the program's answers differ by {worst:.1e} from those of the modules, over {TOLERANCE:.0e}")
        os.replace(whole, path)
    return path


def _asked(
    actor: Actor, written: tuple[dict[str, np.ndarray], dict[str, Any]], team: _Team, manifest: dict[str, Any]
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Returns tensors whose probe has the means of the actor itself, if its deviations and actions are as the file says."""
    import torch

    tensors, form = written
    mean, deviation, action = actor.whole(team.observation)
    out = torch.from_numpy(tensors["probe.output"])
    spread = out[:, 2:].exp() if manifest["deviation"] == "log" else biased_softplus(out[:, 2:])
    limit = manifest["limit_m_s"]
    taken = limit * out[:, :2].tanh() if manifest["distribution"] == "tanh-normal" else out[:, :2]
    pairs = {"means": (mean, out[:, :2]), "deviations": (deviation, spread), "actions": (action, taken)}
    for name, (theirs, ours) in pairs.items():
        worst = (theirs - ours).abs().max().item()
        if not worst <= TOLERANCE:
            raise ValueError(f"the {name} of the actor differ by {worst:.1e} from those of its parts, over {TOLERANCE:.0e}")
    out[:, :2] = mean
    return {**tensors, "probe.output": out.numpy()}, form


def biased_softplus(x: Tensor) -> Tensor:
    """Returns the standard deviations that TorchRL's "biased_softplus_1.0" makes of outputs: 1 of 0, never below 0.01."""
    import torch

    return torch.nn.functional.softplus(x + SOFTPLUS_BIAS) + 0.01


def _written(actor: Actor, team: _Team) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Returns the tensors of a policy with its answers for a team, and the part of the manifest that says its form."""
    import torch

    encoder, parts, decoder = actor.encoder, actor.hops, actor.decoder
    form, layers = network_of(encoder, "encoder")
    networks, hops, sent = {"encoder": layers}, [], []
    manifest: dict[str, Any] = {"format": 2, "encoder": form}
    x = encoder(team.observation)
    for part in parts:
        if isinstance(part, ACTIVATIONS()):
            if not hops:
                raise Refused("hops", part, "it stands before the first convolution; end the encoder with it")
            update = hops[-1].setdefault("update", {})
            if "output_activation" in update:
                raise Refused("hops", part, "it follows another activation")
            update["output_activation"] = activation_of(part, "hops")
            x = part(x)
            continue
        if isinstance(part, (torch.nn.Sequential, torch.nn.Linear)):
            if not hops:
                raise Refused("hops", part, "it stands before the first convolution; end the encoder with it")
            name = f"hops.{len(hops) - 1}.update"
            hops[-1]["update"], networks[name] = followed(hops[-1]["update"], networks[name], part, "hops")
            x = part(x)
            continue
        sent.append(x)
        # Convolutions without features of edges leave them to those that take them.
        edge = team.edge if edges_of(part) else team.edge[:, :0]
        form, layers = hop_of(part, x.shape[1], edge.shape[1], f"hops[{len(hops)}]")
        index = team.index
        if len(hops) in actor.loops and "self_loop" not in form:
            form["self_loop"] = "zero-edge"
            index = torch.cat([index, torch.arange(len(x)).repeat(2, 1)], dim=1)
            edge = torch.cat([edge, edge.new_zeros(len(x), edge.shape[1])])
        networks |= {f"hops.{len(hops)}.{name}": some for name, some in layers.items()}
        hops.append(form)
        x = part(x, index, edge) if edge.shape[1] > 0 else part(x, index)
    if not hops:
        # A policy without messages gets a hop that ignores messages: its update returns the robot's own input.
        width = x.shape[1]
        sent = [x]
        hops = [{"aggregation": "sum", "update": {"inputs": ["own"], "widths": [width, width]}}]
        networks["hops.0.update"] = [(torch.eye(width), torch.zeros(width))]
    form, layers = network_of(decoder, "decoder")
    out = decoder(x)
    if out.shape[1] == 2:
        weight, bias = layers[-1]
        layers[-1] = (torch.cat([weight, torch.zeros_like(weight)]), torch.cat([bias, torch.full_like(bias, LOG_STD)]))
        form["widths"][-1] = 4
        out = torch.cat([out, torch.full_like(out, LOG_STD)], dim=1)
    manifest |= {"hops": hops, "decoder": form}
    networks["decoder"] = layers
    tensors = {
        f"{name}.{2 * depth}.{kind}": tensor
        for name, some in networks.items()
        for depth, layer in enumerate(some)
        for kind, tensor in zip(("weight", "bias"), layer)
    }
    tensors |= {f"probe.{name}": rows for name, rows in team.inputs.items()}
    tensors |= {"probe.latent": torch.cat(sent, dim=1), "probe.output": out}
    return {name: np.ascontiguousarray(tensor.detach().cpu().numpy(), np.float32) for name, tensor in tensors.items()}, manifest


class _Team:
    """Robots of a probe: eight, of which one receives no message, one a single message and the others four; or as many as
    ``everybody`` says, who all hear each other.

    Attributes:
        observation: What each observes, by the fields of the environment (8, F).
        index: Senders and receivers of the messages (2, E), as PyTorch Geometric takes them.
        edge: Features of the messages' edges (E, D).
        inputs: Tensors of the probe, by name.
    """

    def __init__(self, fields: Sequence[str], edge: Sequence[str], everybody: int | None = None):
        import torch

        robots, rng = everybody or 8, np.random.default_rng(1)
        drawn = rng.uniform(-1.5, 1.5, (3, robots, 2)).round(3).astype(np.float32)
        position, velocity, goal = torch.from_numpy(drawn)
        known: dict[str, Tensor] = {
            "goal-minus-position": goal - position,
            "position": position,
            "velocity": velocity,
            "goal": goal,
            "position-plus-velocity": position + velocity,
        }
        missing = [field for field in fields if field not in known]
        if missing:
            raise Refused("like", None, f"its observation has '{missing[0]}', which cannot be exported")
        self.observation = torch.cat([known[field] for field in fields], dim=1)
        # Whole milliseconds, in which the program counts time here.
        age = torch.from_numpy(rng.integers(0, 200, (robots, robots)).astype(np.float32) / np.float32(1000.0))
        heard = 1 - np.eye(robots, dtype=np.float32)
        if everybody is None:
            heard[:] = 0
            heard[1, 2] = 1
            for robot in range(2, robots):
                heard[robot, rng.choice([other for other in range(robots) if other != robot], 4, replace=False)] = 1
        receiver, sender = torch.from_numpy(heard).nonzero(as_tuple=True)
        self.index = torch.stack([sender, receiver])
        way = position[sender] - position[receiver]
        features = {
            "age": age[receiver, sender, None],
            "relative-position": way,
            "distance": way.norm(dim=1, keepdim=True),
            "relative-velocity": velocity[sender] - velocity[receiver],
        }
        self.edge = torch.cat([features[name] for name in edge] or [way[:, :0]], dim=1)
        self.inputs = {
            "position": position,
            "velocity": velocity,
            "goal": goal,
            "age": age,
            "heard": torch.from_numpy(heard),
        }


def _safetensors(tensors: dict[str, np.ndarray], manifest: dict[str, Any]) -> bytes:
    """Returns a safetensors file: the length of a header, the header as JSON, and the tensors by name."""
    names = sorted(tensors)
    data = b"".join(tensors[name].tobytes() for name in names)
    manifest = {**manifest, "sha256": hashlib.sha256(data).hexdigest()}
    header: dict[str, Any] = {"__metadata__": {"murmurate": json.dumps(manifest)}}
    begin = 0
    for name in names:
        end = begin + tensors[name].nbytes
        header[name] = {"dtype": "F32", "shape": list(tensors[name].shape), "data_offsets": [begin, end]}
        begin = end
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + data
