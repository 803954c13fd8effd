"""Whole actors of BenchMARL and TorchRL, taken apart into the encoder, the convolutions and the decoder of a policy file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from ._hops import Refused
from ._like import Seen

if TYPE_CHECKING:
    from torch import Tensor, nn

#: Bias of TorchRL's "biased_softplus_1.0".
SOFTPLUS_BIAS = math.log(math.expm1(1.0 - 0.01))
#: Communication range of an exported policy whose network takes the messages of all robots [m].
EVERYWHERE_M = 100.0
#: Models of BenchMARL that a policy file can hold.
MODELS = ("Mlp", "Gnn", "SequenceModel")
#: Models of BenchMARL with a state, which a policy file cannot hold.
MEMORY = ("Gru", "Lstm")


@dataclasses.dataclass
class Actor:
    """An actor in the parts of a policy file.

    Attributes:
        encoder, hops, decoder: Network before the convolutions; the convolutions, with the layers that follow each;
            network after the convolutions.
        loops: Numbers, from 0, of the convolutions in which a robot is one of its own neighbours.
        edge: Features of an edge, by the names of a policy file.
        manifest: Fields of the manifest that the actor decides.
        whole: Function that runs the original actor on the observations (R, F) of a team. It returns mean and standard
            deviation of the normal distribution, and the deterministic action, each (R, 2). None without such an actor.
    """

    encoder: nn.Module
    hops: list[nn.Module]
    decoder: nn.Module
    loops: set[int] = dataclasses.field(default_factory=set)
    edge: list[str] = dataclasses.field(default_factory=list)
    manifest: dict[str, Any] = dataclasses.field(default_factory=dict)
    whole: Callable[[Tensor], tuple[Tensor, Tensor, Tensor]] | None = None


def module_of(policy: Any) -> Any:
    """Returns the policy of the one group of robots of a policy of BenchMARL or TorchRL.

    Raises:
        Refused: It is no such policy, or of several groups.
    """
    from torch import nn

    policies = getattr(policy, "group_policies", None)
    if policies is not None:
        if len(policies) != 1:
            raise Refused("policy", None, f"its groups {', '.join(policies)} have policies of their own; give one of them")
        policy = next(iter(policies.values()))
    elif type(policy).__name__ == "TensorDictSequential" and len(list(policy.module)) == 1:
        # The policy of an experiment with one group.
        policy = policy.module[0]
    if not isinstance(policy, nn.Module) or not hasattr(policy, "in_keys"):
        raise Refused("policy", None, f"{type(policy).__name__} is no actor of BenchMARL or TorchRL; give encoder, hops and decoder")
    return policy


def actor_of(policy: Any, fields: Sequence[str], limit_m_s: float, seen: Seen) -> Actor:
    """Takes a policy of BenchMARL or TorchRL apart into the parts of a policy file.

    Args:
        policy: Policy of one group of robots, as :func:`module_of` returns it.
        fields: Names of the entries of an observation, in order; each has two floats.
        limit_m_s: Largest velocity along an axis [m/s].
        seen: What the policy reads of an observation.

    Raises:
        Refused: A policy file cannot hold the policy.
    """
    import torch
    from torch import nn

    parts = list(_parts(policy))
    distributions = [part for part in parts if hasattr(part, "distribution_class")]
    extractors = [part for part in parts if type(part).__name__ == "NormalParamExtractor"]
    if len(distributions) != 1 or len(extractors) != 1 or parts[-1] is not distributions[0] or parts[-2] is not extractors[0]:
        raise Refused("policy", None, "an actor ends with NormalParamExtractor and the distribution of its actions")
    manifest = _distribution(distributions[0], extractors[0], limit_m_s)
    parts = parts[:-2]

    sections: list[list[nn.Module]] = [[]]
    gnns: list[Any] = []
    for part in parts:
        if type(part).__name__ == "Gnn":
            gnns.append(part)
            sections.append([])
        else:
            sections[-1].append(part)
    if gnns:
        manifest["radius_m"] = EVERYWHERE_M
    first = gnns[0] if gnns and not sections[0] else None
    edge = _edge_of(gnns[0]) if gnns else []
    entry = _entry(_read(policy, first), fields, seen)
    encoder: list[nn.Module] = sections[0]
    if not gnns:
        encoder, decoder = [entry], sections[0]
    else:
        encoder = entered(entry, sections[0])
        width = gnns[-1].output_features
        decoder = sections[-1] or [_matrix(torch.eye(width))]
    if manifest["deviation"] == "biased-softplus":
        # A policy file has the bias with which 0 becomes 1; what another bias has more or less goes into the last layer.
        more = float(extractors[0].scale_mapping.bias) - SOFTPLUS_BIAS
        decoder = [*decoder[:-1], _shifted(decoder[-1], torch.tensor([0.0, 0.0, more, more]))]
    hops: list[nn.Module] = []
    for at, gnn in enumerate(gnns):
        hops.append(gnn.gnns[0])
        if at + 1 < len(gnns) and sections[at + 1]:
            hops.append(nn.Sequential(*sections[at + 1]))
    loops = {at for at, gnn in enumerate(gnns) if gnn.self_loops}
    return Actor(nn.Sequential(*encoder), hops, nn.Sequential(*decoder), loops, edge, manifest, _whole(policy, fields, seen))


def _parts(module: Any, more: Sequence[str] = ()) -> Iterator[Any]:
    """Returns the parts of an actor in their order: layers, graph networks, and what makes actions of their output.

    Models of BenchMARL whose names are in ``more`` are parts as they are.
    """
    from torch import nn

    name = type(module).__name__
    of_benchmarl = type(module).__module__.startswith("benchmarl.")
    if of_benchmarl and name in more:
        yield module
        return
    if of_benchmarl and name not in MODELS:
        memory = "; export_graph(file, **murmurate.actors.benchmarl(experiment)) takes it" if name in MEMORY else ""
        raise Refused("policy", module, f"such a model of BenchMARL is none of {', '.join(MODELS)}{memory}")
    if of_benchmarl and name == "Mlp":
        yield from _parts(module.mlp, more)
    elif of_benchmarl and name == "Gnn":
        if not module.share_params:
            raise Refused("policy", module, "a network for each robot; a policy file has one for all (share_policy_params)")
        if module.topology != "full":
            raise Refused("policy", module, f"its topology '{module.topology}' is not 'full'")
        yield module
    elif of_benchmarl:
        yield from _parts(module.models, more)
    elif name == "MultiAgentMLP":
        if not module.share_params or module.centralized:
            why = "a robot would need what all observe" if module.centralized else "a network for each robot"
            raise Refused("policy", module, f"{why}; a policy file has one network for all (share_params, not centralized)")
        yield from _parts(module.get_stateful_net(), more)
    elif hasattr(module, "distribution_class"):
        yield module
    elif isinstance(module, nn.Sequential):
        for part in module:
            yield from _parts(part, more)
    elif hasattr(module, "in_keys") and hasattr(module, "module"):
        inner = module.module
        for part in inner if isinstance(inner, (nn.ModuleList, list, tuple)) else [inner]:
            yield from _parts(part, more)
    else:
        yield module


def _distribution(head: Any, extractor: Any, limit_m_s: float) -> dict[str, Any]:
    """Returns the fields of the manifest that say what the last outputs of the network mean."""
    import torch

    name = head.distribution_class.__name__
    mapping, given = extractor.scale_mapping, dict(head.distribution_kwargs)
    if mapping is torch.exp:
        deviation = "log"
    elif type(mapping).__name__ == "biased_softplus" and mapping.min_val == 0.01:
        deviation = "biased-softplus"
    else:
        raise Refused("policy", extractor, "its scale_mapping is neither 'exp' nor a 'biased_softplus'")
    if name in ("IndependentNormal", "Normal"):
        return {"distribution": "diagonal-normal", "deviation": deviation}
    if name != "TanhNormal":
        raise Refused("policy", head, f"its distribution {name} is neither IndependentNormal nor TanhNormal")
    if given.get("tanh_loc"):
        raise Refused("policy", head, "TanhNormal with tanh_loc")
    for end, value in (("low", -limit_m_s), ("high", limit_m_s)):
        bound = torch.as_tensor(given.get(end, -1.0 if end == "low" else 1.0), dtype=torch.float32)
        if not torch.allclose(bound, torch.tensor(value), atol=1e-6):
            raise Refused("policy", head, f"'{end}' of TanhNormal is not {value:.6g} m/s, the limit of the environment")
    return {"distribution": "tanh-normal", "deviation": deviation}


def _edge_of(gnn: Any) -> list[str]:
    """Returns the features that a graph network of BenchMARL makes of positions and velocities."""
    if not gnn.gnn_supports_edge_attrs:
        return []
    edge = ["relative-position", "distance"] if gnn.position_key is not None else []
    return edge + (["relative-velocity"] if gnn.velocity_key is not None else [])


def _read(policy: Any, first: Any) -> list[str]:
    """Returns the keys that the first network reads, in its order, by the last word of each."""
    last = lambda key: key if isinstance(key, str) else key[-1]
    # Keys of intermediate results begin with an underscore.
    keys = [last(key) for key in policy.in_keys]
    if first is None:
        return keys
    apart = [key for key in (first.position_key, first.velocity_key) if key is not None]
    read = [last(key) for key in first.in_keys if last(key) not in apart]
    if first.position_key is not None and not first.exclude_pos_from_node_features:
        read.append(first.position_key)
    return read + ([first.velocity_key] if first.velocity_key is not None else [])


def _entry(keys: Sequence[str], fields: Sequence[str], seen: Seen) -> nn.Module:
    """Returns a linear layer that makes what the keys hold of an observation, of which the policy reads ``seen``."""
    import torch

    rows = torch.eye(2 * len(fields))
    nothing = torch.zeros(2)

    def of(field: str) -> Tensor:
        if field not in fields:
            raise Refused("like", None, f"its observation does not have '{field}', which the policy reads")
        at = 2 * fields.index(field)
        return rows[at : at + 2]

    def velocity() -> Tensor:
        return of("velocity") if "velocity" in fields else of("position-plus-velocity") - of("position")

    # Only the observation as a whole is read through a transform.
    known: dict[str, Callable[[], tuple[Tensor, Tensor]]] = {
        "observation": lambda: (rows * seen.scale[:, None], seen.loc),
        "position": lambda: (of("position"), nothing),
        "velocity": lambda: (velocity(), nothing),
    }
    unknown = [key for key in keys if key not in known]
    if unknown:
        raise Refused("policy", None, f"it reads the key '{unknown[0]}', which is none of {', '.join(known)}")
    weights, biases = zip(*(known[key]() for key in keys))
    return _matrix(torch.cat(weights), torch.cat(biases))


def _matrix(weight: Tensor, bias: Tensor | None = None) -> nn.Module:
    """Returns a linear layer of this weight and bias; a bias of zeros is none."""
    from torch import nn

    has_bias = bias is not None and bool((bias != 0).any())
    layer = nn.Linear(weight.shape[1], weight.shape[0], bias=has_bias)
    layer.weight.data.copy_(weight)
    if bias is not None and has_bias:
        layer.bias.data.copy_(bias)
    return layer


def _shifted(layer: Any, more: Tensor) -> Any:
    """Returns a linear layer whose outputs are larger by so much."""
    from torch import nn

    if not isinstance(layer, nn.Linear) or layer.weight.shape[0] != 4:
        raise Refused("policy", layer, "it is not a linear layer with four outputs, which are to be those of the network")
    moved = _matrix(layer.weight.detach())
    moved.bias = nn.Parameter(more if layer.bias is None else layer.bias.detach() + more)
    return moved


def entered(entry: Any, section: list[nn.Module]) -> list[nn.Module]:
    """Returns the layers of a section whose inputs are made by a linear layer, as layers of that layer's inputs."""
    import torch
    from torch import nn

    if not section or not isinstance(section[0], nn.Linear):
        return [entry, *section]
    first = section[0]
    weight = first.weight.detach()
    if weight.shape[1] != entry.weight.shape[0]:
        raise Refused("policy", first, f"it takes {weight.shape[1]} floats, and the policy reads {entry.weight.shape[0]}")
    bias = torch.zeros(weight.shape[0]) if first.bias is None else first.bias.detach()
    if entry.bias is not None:
        bias = bias + weight @ entry.bias.detach()
    return [_matrix(weight @ entry.weight.detach(), bias), *section[1:]]


def read_through(seen: Seen, section: list[nn.Module]) -> list[nn.Module]:
    """Returns the layers of a section that reads an observation through ``seen``, as layers of the observation itself."""
    import torch

    return section if seen.is_raw else entered(_matrix(torch.diag(seen.scale), seen.loc), section)


def _whole(policy: Any, fields: Sequence[str], seen: Seen) -> Callable[[Tensor], tuple[Tensor, Tensor, Tensor]]:
    """Returns a function that asks the actor itself, as its trainer does."""

    def answer(observation: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        import torch
        from tensordict import TensorDict
        from torchrl.envs.utils import ExplorationType, set_exploration_type

        team = TensorDict({}, batch_size=[1])
        for key in policy.in_keys:
            made = _entry([key if isinstance(key, str) else key[-1]], fields, seen)(observation)
            team.set(key, made.unsqueeze(0))
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            distribution = policy.get_dist(team.clone())
            action = policy(team.clone())
        base = distribution
        while hasattr(base, "base_dist"):
            base = base.base_dist
        taken = next(action.get(key) for key in policy.out_keys if (key if isinstance(key, str) else key[-1]) == "action")
        return base.loc[0], base.scale[0], taken[0]

    return answer
