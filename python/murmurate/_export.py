"""Export of policies from PyTorch and PyTorch Geometric to policy files of format 2, or else to graphs of format 3."""

from __future__ import annotations

import hashlib
import json
import math
import os
import pathlib
import tempfile
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ._actors import SOFTPLUS_BIAS, Actor, actor_of, module_of, read_through
from ._files import CONTRACT, path_of
from ._hops import (
    ACTIVATIONS,
    Inexact,
    Refused,
    activation_of,
    applied,
    checked,
    edges_of,
    evaluated,
    flat,
    followed,
    hop_of,
    network_of,
)
from ._like import Seen, environment_of, seen_through
from ._module import VecEnv
from ._probe import EDGE_WIDTHS, Team
from ._program import finished

if TYPE_CHECKING:
    from torch import Tensor, nn

#: Tensors of a file by name, and fields of its manifest.
_Written = tuple[dict[str, np.ndarray], dict[str, Any]]

#: Largest difference between what PyTorch and the program compute for the robots of the probe.
TOLERANCE = 1e-5
#: Values of arguments that are names.
NAMES = {
    "distribution": ("diagonal-normal", "tanh-normal"),
    "deviation": ("log", "biased-softplus"),
    "draw": ("mean", "sample"),
}
#: Bounds of the hold time: a step, and what a policy file may have [s].
HOLDS_S = (0.05, 60.0)
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
    hold_s: float | None = None,
) -> pathlib.Path:
    """Writes a policy of PyTorch modules to a policy file, for ``sim``, ``study`` and robots.

    The policy is ``decoder(hops(encoder(observation)))``. The file holds the outputs of the modules for eight robots, of
    which one receives no message, one receives one and the others four. The program computes them again from the file;
    without agreement within 1e-5 there is no file.

    Without ``hops`` and ``decoder`` the second argument is a whole actor of BenchMARL or TorchRL, which is taken apart. It must
    itself agree within 1e-5 with the program, for a team in which every robot receives the messages of all others.

    What format 2 cannot hold becomes a policy of format 3, as :func:`export_graph` writes it, if the name of the file permits
    it: other layers, and the convolutions ``EdgeConv``, ``GATConv``, ``GCNConv``, ``GINConv``, ``SAGEConv`` and ``TAGConv``.

    Args:
        file: File to write, or to replace. NAME.policy.toml is a policy of format 3, a name without an end is one of format 2 or
            else NAME.policy.toml, and any other name is a file of format 2.
        encoder: ``Linear`` layers with one kind of activation between them, in a ``Sequential``; its input is ``obs``. Or a
            whole actor: an ``Experiment`` of BenchMARL or its policy, whose models are ``Mlp`` and ``Gnn`` with the topology
            "full", or a ``ProbabilisticActor`` of TorchRL. ``edge``, ``distribution`` and ``deviation`` are then its own.
        hops: Convolutions of PyTorch Geometric (``GraphConv``, ``GATv2Conv``, ``GINEConv``, ``TransformerConv``), each
            followed by an activation or a network if there is one. Empty for a policy without messages.
        decoder: As the encoder; its outputs are the velocity along x and y [m/s], policy frame, and the parameters of
            their standard deviations. With two outputs alone these are constant.
        like: Environment in which the policy was trained, a :class:`murmurate.VecEnv` or one of the faces: it has the task,
            the observation, the radius [m], the limit of speed [m/s] and the hold time [s]. For an ``Experiment`` that of
            its task. An ``ObservationNorm`` of TorchRL around it is folded into the first layer; other transforms and
            wrappers that change what the policy observes or commands are refused.
        scenario: Task for which the file is; None takes that of the environment.
        edge: Features of an edge in the order in which convolutions take them: "age" [s], "relative-position" [m],
            "distance" [m], "relative-velocity" [m/s]; those of the sender minus those of the receiver.
        distribution: Distribution of actions; "tanh-normal" is the limit of speed times tanh of a normal one.
        deviation: What the decoder's last two outputs are: log standard deviations, or TorchRL's "biased_softplus_1.0".
        draw: Whether deployed robots take the mean or draw a sample.
        hold_s: Longest time for which a neighbour's message is used [s]; None takes that of the environment.

    Each module is in training or evaluation afterwards as it was before.

    Returns:
        File that the program runs.

    Raises:
        ValueError: A module cannot be written to such a file, or an argument is wrong, by name; or the program's answers
            differ.
    """
    path = path_of(file)
    try:
        edge = _edge(edge)
        given = {"distribution": distribution, "deviation": deviation, "draw": draw}
        _check_names(given)
        if (hops is None) != (decoder is None):
            missing = "hops" if hops is None else "decoder"
            raise Refused(missing, None, "give encoder, hops and decoder, or a whole actor alone")
        core, seen, whole = _trained_in(encoder, hops, like)
        manifest = given | {"scenario": _scenario(scenario, core), "hold_s": _hold_s(hold_s, core), "rate_hz": 20.0}
        manifest |= {"observation": core.observation_fields}
        manifest |= {"radius_m": round(core.radius_m, 6), "limit_m_s": round(core.limit_m_s, 6)}
        parts = (encoder, hops, decoder)
        try:
            if path.name.endswith(CONTRACT):
                return _as_graph(path, whole, parts, edge, core, seen, manifest)
            written = _of_parts(parts, edge, core, seen, manifest) if whole is None else _of_actor(whole, core, seen, manifest)
        except Inexact as inexact:
            if path.suffix:
                name = path.name.removesuffix(path.suffix) + CONTRACT
                raise ValueError(f"{inexact}; to write it as a graph of format 3, name the file '{name}'") from None
            return _as_graph(path.with_name(path.name + CONTRACT), whole, parts, edge, core, seen, manifest)
    except Refused as refused:
        raise ValueError(str(refused)) from None
    _write(path, written)
    return path


def _trained_in(encoder: Any, hops: Any, like: Any) -> tuple[VecEnv, Seen, Any]:
    """Returns the environment of the policy, what it reads of observations, and the actor if it is a whole one."""
    whole = None
    if hops is None:
        whole, task = encoder, getattr(encoder, "task", None)
        if like is None and hasattr(task, "environment"):
            like = encoder.test_env if hasattr(encoder, "test_env") else task.environment()
    if like is None:
        raise Refused("like", None, "missing; give the environment in which the policy was trained")
    core, transforms = environment_of(like)
    return core, seen_through(transforms, core), whole


def _of_actor(policy: Any, core: VecEnv, seen: Seen, manifest: dict[str, Any]) -> list[_Written]:
    """Returns what files of a whole actor hold: one that is asked as the actor itself, and the one to keep."""
    import torch

    policy = checked(module_of(policy), "policy")
    with evaluated([policy]), torch.no_grad():
        actor = actor_of(policy, core.observation_fields, core.limit_m_s, seen)
        manifest |= actor.manifest | {"edge": actor.edge}
        with evaluated([actor.encoder, *actor.hops, actor.decoder]):
            everybody = Team(core.observation_fields, actor.edge, core.num_robots)
            asked = _asked(actor, _written(actor, everybody), everybody, manifest)
            kept = _written(actor, Team(core.observation_fields, actor.edge))
    return [(tensors, manifest | form) for tensors, form in (asked, kept)]


def _of_parts(
    parts: tuple[Any, Any, Any], edge: list[str], core: VecEnv, seen: Seen, manifest: dict[str, Any]
) -> list[_Written]:
    """Returns what the file of a policy of three parts holds."""
    import torch

    encoder, hops, decoder = checked(parts[0], "encoder"), _hops(parts[1]), checked(parts[2], "decoder")
    manifest |= {"edge": edge}
    with evaluated([encoder, *hops, decoder]), torch.no_grad():
        team = Team(core.observation_fields, edge)
        form, _ = network_of(encoder, "encoder")
        takes, floats = form["widths"][0], team.observation.shape[1]
        if takes != floats:
            fields = ", ".join(core.observation_fields)
            raise Refused("encoder", encoder, f"its first layer takes {takes} floats, and an observation has {floats} ({fields})")
        direct = encoder
        if not seen.is_raw:
            direct = torch.nn.Sequential(*read_through(seen, flat(encoder)))
            with evaluated([direct]):
                worst = (direct(team.observation) - encoder(seen.of(team.observation))).abs().max().item()
            if not worst <= TOLERANCE:
                raise Refused("like", None, f"folding its ObservationNorm into the encoder changes outputs by {worst:.1e}")
        tensors, form = _written(Actor(direct, hops, decoder, edge=edge), team)
    return [(tensors, manifest | form)]


def _as_graph(
    path: pathlib.Path,
    whole: Any,
    parts: tuple[Any, Any, Any],
    edge: list[str],
    core: VecEnv,
    seen: Seen,
    manifest: dict[str, Any],
) -> pathlib.Path:
    """Writes a policy of format 3 of the parts, or of a whole actor if there is one, and returns its contract."""
    import torch

    from ._graph import export_graph
    from ._teams import mean_action, modules_of
    from ._wrapped import Affine

    if manifest["draw"] == "sample":
        raise Refused("draw", None, "a contract does not say 'sample'; say it when the policy runs: --action sample")
    if whole is None:
        encoder, decoder = checked(parts[0], "encoder"), checked(parts[2], "decoder")
        encoder = encoder if seen.is_raw else torch.nn.Sequential(Affine(0.0, seen.scale, seen.loc), encoder)
        actor = Actor(encoder, _hops(parts[1]), decoder, edge=edge, manifest=manifest)
    else:
        policy = checked(module_of(whole), "policy")
        actor = actor_of(policy, core.observation_fields, core.limit_m_s, seen)
        edge, manifest = actor.edge, manifest | actor.manifest
    limit = manifest["limit_m_s"]
    with evaluated([actor.encoder, *actor.hops, actor.decoder, *([policy] if whole is not None else [])]), torch.no_grad():
        modules = modules_of(actor, edge, limit, core.obs.shape[2])
        if actor.whole is not None:
            team = Team(core.observation_fields, edge, core.num_robots)
            mean, deviation, action = actor.whole(team.observation)
            ours = mean_action(modules, team.observation, team.index, team.edge, steps=16)
            theirs = action if ours.shape[1] == 2 else torch.cat([mean, deviation.log()], dim=1)
            worst = (ours - theirs).abs().max().item()
            if not worst <= TOLERANCE:
                raise ValueError(f"the actions of the actor differ by {worst:.1e} from those of its parts, over {TOLERANCE:.0e}")
        return export_graph(
            path, **modules, like=core, edges=edge, sign="theirs-minus-own", limit=limit, radius_m=manifest["radius_m"],
            hold_s=manifest["hold_s"],
        )  # fmt: skip


def _write(path: pathlib.Path, written: list[_Written]) -> None:
    """Writes the last of these files, if the program answers each of them as PyTorch does."""
    with tempfile.TemporaryDirectory(dir=path.absolute().parent) as folder:
        whole = pathlib.Path(folder) / "policy.safetensors"
        for tensors, manifest in written:
            whole.write_bytes(_safetensors(tensors, manifest))
            try:
                probe = json.loads(finished(["policy", "check", str(whole), "--json"]))["probe"]
            except ValueError as error:
                # The file that the program has read is gone when somebody reads this.
                raise ValueError(str(error).replace(str(whole), str(path))) from None
            worst = max(probe["latent_difference"], probe["output_difference"])
            if not worst <= TOLERANCE:
                raise ValueError(f"the program's answers differ by {worst:.1e} from those of the modules, over {TOLERANCE:.0e}")
        os.replace(whole, path)


def _edge(given: Any) -> list[str]:
    """Returns the features of edges, if they are a list of such."""
    if isinstance(given, str) or not isinstance(given, Sequence):
        shown = f"'{given}' is a text" if isinstance(given, str) else f"a {type(given).__name__} is no list"
        raise Refused("edge", None, f"{shown}; give a list, such as ['age', 'relative-position']")
    unknown = [name for name in given if name not in EDGE_WIDTHS]
    if unknown:
        raise Refused("edge", None, f"{unknown[0]!r} is none of {', '.join(EDGE_WIDTHS)}")
    return list(given)


def _check_names(given: dict[str, Any]) -> None:
    for argument, value in given.items():
        if value not in NAMES[argument]:
            raise Refused(argument, None, f"{value!r} is none of {', '.join(NAMES[argument])}")


def _hops(given: Any) -> list[Any]:
    """Returns the convolutions with what follows each, if they are a list of modules."""
    from torch import nn

    if not isinstance(given, (list, tuple, nn.ModuleList, nn.Sequential)):
        raise Refused("hops", None, f"a {type(given).__name__} is no list; give [{type(given).__name__}(...)]")
    return [checked(part, f"hops[{at}]") for at, part in enumerate(given)]


def _scenario(given: str | None, core: VecEnv) -> str:
    """Returns the scenario of a file: one that there is, or that of the environment."""
    return core.scenario if given is None else VecEnv(given).scenario


def _hold_s(given: float | None, core: VecEnv) -> float:
    """Returns the hold time of a file [s]: one that is possible, or that of the environment."""
    if given is None:
        return core.hold_s
    if isinstance(given, bool) or not isinstance(given, (int, float, np.number)) or not math.isfinite(given):
        raise Refused("hold_s", None, f"{given!r} is no time in seconds")
    if not HOLDS_S[0] <= given <= HOLDS_S[1]:
        raise Refused("hold_s", None, f"{given} is not {HOLDS_S[0]} to {HOLDS_S[1]}")
    return float(given)


def _asked(actor: Actor, written: _Written, team: Team, manifest: dict[str, Any]) -> _Written:
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


def _written(actor: Actor, team: Team) -> _Written:
    """Returns the tensors of a policy with its answers for a team, and the part of the manifest that says its form."""
    import torch

    encoder, parts, decoder = actor.encoder, actor.hops, actor.decoder
    form, layers = network_of(encoder, "encoder")
    networks, hops, sent = {"encoder": layers}, [], []
    manifest: dict[str, Any] = {"format": 2, "encoder": form}
    x = applied(encoder, "encoder", team.observation)
    for at, part in enumerate(parts):
        if isinstance(part, ACTIVATIONS()):
            if not hops:
                raise Refused("hops", part, "it stands before the first convolution; end the encoder with it")
            update = hops[-1].setdefault("update", {})
            if "output_activation" in update:
                raise Refused("hops", part, "it follows another activation")
            update["output_activation"] = activation_of(part, "hops")
            x = applied(part, f"hops[{at}]", x)
            continue
        if isinstance(part, (torch.nn.Sequential, torch.nn.Linear)):
            if not hops:
                raise Refused("hops", part, "it stands before the first convolution; end the encoder with it")
            name = f"hops.{len(hops) - 1}.update"
            hops[-1]["update"], networks[name] = followed(hops[-1]["update"], networks[name], part, f"hops[{at}]")
            x = applied(part, f"hops[{at}]", x)
            continue
        sent.append(x)
        # Convolutions without features of edges leave them to those that take them.
        edge = team.edge if edges_of(part) else team.edge[:, :0]
        form, layers = hop_of(part, x.shape[1], edge.shape[1], f"hops[{at}]")
        index = team.index
        if len(hops) in actor.loops and "self_loop" not in form:
            form["self_loop"] = "zero-edge"
            index = torch.cat([index, torch.arange(len(x)).repeat(2, 1)], dim=1)
            edge = torch.cat([edge, edge.new_zeros(len(x), edge.shape[1])])
        networks |= {f"hops.{len(hops)}.{name}": some for name, some in layers.items()}
        hops.append(form)
        x = applied(part, f"hops[{at}]", x, index, *([edge] if edge.shape[1] > 0 else []))
    if not hops:
        # A policy without messages gets a hop that ignores messages: its update returns the robot's own input.
        width = x.shape[1]
        sent = [x]
        hops = [{"aggregation": "sum", "update": {"inputs": ["own"], "widths": [width, width]}}]
        networks["hops.0.update"] = [(torch.eye(width), torch.zeros(width))]
    form, layers = network_of(decoder, "decoder")
    takes, puts = form["widths"][0], form["widths"][-1]
    if takes != x.shape[1]:
        raise Refused("decoder", decoder, f"its first layer takes {takes} floats, and what is before it gives {x.shape[1]}")
    if puts not in (2, 4):
        raise Refused("decoder", decoder, f"it has {puts} outputs; give 2, a velocity, or 4, with its standard deviations")
    out = applied(decoder, "decoder", x)
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
