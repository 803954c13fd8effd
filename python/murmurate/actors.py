"""Actors of other trainers as arguments of :func:`murmurate.export_graph`: module, normalisation, frames and limits.

Needs PyTorch.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from ._actors import MEMORY, _parts, module_of
from ._hops import Refused, evaluated
from ._wrapped import Affine

#: Largest difference between the actions of a trainer and those of the module that was made of it.
TOLERANCE = 1e-5


class Network(nn.Module):
    """Network whose outputs are means, of a normal distribution with constant deviations or none, or logits.

    Args:
        network: Layers from the observation to the outputs.
        log_std: Log standard deviations; None without a distribution.
        squash: Lower and upper ends to which outputs are scaled from -1 to 1; None if they are not.
        tanh: Whether they come from tanh of the outputs, with ``squash``.
    """

    def __init__(
        self, network: nn.Module, log_std: Tensor | None = None, squash: tuple[Tensor, Tensor] | None = None, tanh: bool = True
    ):
        super().__init__()
        self.network, self.tanh, self.squash = network, tanh, squash is not None
        self.register_buffer("log_std", log_std)
        low, high = (None, None) if squash is None else squash
        self.register_buffer("low", low)
        self.register_buffer("high", high)

    def forward(self, observation: Tensor) -> Tensor:
        out = self.network(observation)
        if self.squash:
            unit = out.tanh() if self.tanh else out
            return self.low + 0.5 * (unit + 1.0) * (self.high - self.low)
        if self.log_std is not None:
            out = torch.cat([out, self.log_std.expand_as(out)], dim=1)
        return out


def sb3(model: Any, env: Any = None) -> dict[str, Any]:
    """Returns the actor of a model of Stable-Baselines3, for one robot, as arguments of ``export_graph``.

    Taken are PPO and A2C, with velocities as means of a normal distribution or with choices, and SAC, TD3, DDPG and DQN. With
    choices, give their velocities to ``export_graph`` as ``choices``. The model is asked for some actions, and the layers that are
    taken from it have to agree with them.

    Args:
        model: Model with the policy "MlpPolicy".
        env: Environment with the ``VecNormalize`` and ``VecFrameStack`` of the training; None takes that of the model.
    """
    policy, space = model.policy, model.action_space
    try:
        network, options = _sb3_network(policy, space)
        env = model.get_env() if env is None else env
        if env is None:
            raise Refused("env", None, "the model has none; give that of the training, with its VecNormalize if it had one")
        frames, inner, outer = _sb3_wrappers(env)
    except Refused as refused:
        raise ValueError(str(refused)) from None
    floats = model.observation_space.shape[0]
    with evaluated([policy, network]), torch.no_grad():
        seen = torch.randn(64, floats, generator=torch.Generator().manual_seed(1))
        theirs = torch.as_tensor(model.predict(seen.numpy(), deterministic=True)[0])
        ours = network(seen.to(next(policy.parameters()).device)).cpu()
    if options["action"] == "choice":
        worst = float((ours.argmax(1) != theirs).any())
    else:
        low, high = (torch.as_tensor(end) for end in (space.low, space.high))
        worst = (ours[:, : theirs.shape[1]].clamp(low, high) - theirs).abs().max().item()
    if not worst <= TOLERANCE:
        raise ValueError(f"model: its actions differ by {worst:.1e} from those of the layers that were taken from it")
    arguments: dict[str, Any] = {"step": network if outer is None else nn.Sequential(outer, network), **options}
    if frames > 1:
        arguments["stack"] = frames
    if inner is not None:
        arguments["normalize"] = inner
    return arguments


def _sb3_network(policy: Any, space: Any) -> tuple[Network, dict[str, Any]]:
    """Returns the network of the actor, and the arguments of ``export_graph`` that say what its outputs are."""
    kind = type(space).__name__
    actor = getattr(policy, "actor", None)
    if kind == "Discrete":
        if hasattr(policy, "q_net"):
            layers = [policy.q_net.features_extractor, policy.q_net.q_net]
        else:
            layers = [policy.pi_features_extractor, policy.mlp_extractor.policy_net, policy.action_net]
        return Network(nn.Sequential(*layers)), {"action": "choice"}
    if kind != "Box" or space.shape != (2,):
        raise Refused("model", policy, f"its actions {space} are not two numbers of one robot, or a choice")
    low, high = (torch.as_tensor(end, dtype=torch.float32) for end in (space.low, space.high))
    limit = round(float(high[0]), 6)
    if not (torch.allclose(high, high[:1]) and torch.allclose(low, -high)):
        raise Refused("model", policy, f"its actions {space} have other limits than one for both axes")
    if actor is not None:
        squash = (low, high)
        if hasattr(actor, "latent_pi"):
            layers = [actor.features_extractor, actor.latent_pi, actor.mu]
            return Network(nn.Sequential(*layers), squash=squash), {"action": "velocity", "limit": limit}
        # The last layer of TD3 and DDPG is a tanh.
        network = Network(nn.Sequential(actor.features_extractor, actor.mu), squash=squash, tanh=False)
        return network, {"action": "velocity", "limit": limit}
    if getattr(policy, "use_sde", False) or not hasattr(policy, "log_std"):
        raise Refused("model", policy, "its distribution is no diagonal normal one (use_sde); train without it")
    layers = [policy.pi_features_extractor, policy.mlp_extractor.policy_net, policy.action_net]
    network = Network(nn.Sequential(*layers), log_std=policy.log_std.detach().clone())
    return network, {"action": "velocity", "limit": limit, "distribution": "diagonal-normal"}


def _sb3_wrappers(env: Any) -> tuple[int, Any, Affine | None]:
    """Returns the number of frames, and the normalisations before and after they are stacked; None for none."""
    frames, inner, outer = 1, None, None
    for _ in range(100):
        kind = type(env).__name__
        if kind == "VecNormalize" and env.norm_obs:
            mean, deviation = env.obs_rms.mean, (env.obs_rms.var + env.epsilon) ** 0.5
            if inner is not None or outer is not None:
                raise Refused("env", None, "it has more than one VecNormalize")
            if any(type(below).__name__ == "VecFrameStack" for below in _below(env)):
                outer = Affine(mean, 1.0 / deviation, 0.0 * mean, float(env.clip_obs))
            else:
                inner = (mean, deviation, float(env.clip_obs))
        elif kind == "VecFrameStack":
            frames = env.stacked_obs.n_stack
        elif kind in ("VecTransposeImage", "VecExtractDictObs"):
            raise Refused("env", None, f"{kind} changes what the policy observes")
        inside = vars(env).get("venv")
        if inside is None:
            break
        env = inside
    return frames, inner, outer


def _below(env: Any) -> list[Any]:
    """Returns the environments within a wrapper of Stable-Baselines3."""
    found: list[Any] = []
    while vars(env).get("venv") is not None and len(found) < 100:
        env = env.venv
        found.append(env)
    return found


def torchrl(actor: Any) -> dict[str, Any]:
    """Returns an actor of TorchRL, for one robot, as arguments of ``export_graph``.

    Taken is a ``ProbabilisticActor`` with one input whose last parts are ``NormalParamExtractor`` and ``IndependentNormal`` or
    ``TanhNormal``, or ``Categorical`` or ``OneHotCategorical`` of logits, for which ``export_graph`` needs ``choices``.
    """
    try:
        return _of_parts(actor)
    except Refused as refused:
        raise ValueError(str(refused)) from None


def benchmarl(experiment: Any) -> dict[str, Any]:
    """Returns the actor of an ``Experiment`` of BenchMARL on ``murmurate.benchmarl.Task``, as arguments of ``export_graph``.

    It may have the models ``Gru`` and ``Lstm``, whose hidden states are the state of the policy, beside ``Mlp``. For one with
    ``Gnn``, :func:`murmurate.export` is the function.
    """
    try:
        policy = module_of(experiment.policy)
        keys = [key if isinstance(key, str) else key[-1] for key in policy.in_keys]
        others = [key for key in keys if key not in ("observation", "is_init") and not key.startswith("_")]
        if others:
            raise Refused("experiment", policy, f"it observes '{others[0]}'; train it with Task(..., edges=False)")
        like = experiment.test_env if hasattr(experiment, "test_env") else experiment.task.environment()
        return {"like": like, **_of_parts(policy)}
    except Refused as refused:
        raise ValueError(str(refused)) from None


def _of_parts(actor: Any) -> dict[str, Any]:
    parts = list(_parts(actor, MEMORY))
    if len(parts) < 2 or not hasattr(parts[-1], "distribution_class"):
        raise Refused("actor", actor, "it does not end with the distribution of its actions")
    *layers, head = parts
    name, given = head.distribution_class.__name__, dict(head.distribution_kwargs)
    if name in ("Categorical", "OneHotCategorical"):
        return {"step": Layers(layers, nn.Identity()), "action": "choice"}
    *layers, extractor = layers
    if type(extractor).__name__ != "NormalParamExtractor" or name not in ("IndependentNormal", "Normal", "TanhNormal"):
        raise Refused("actor", actor, f"its distribution {name} is none that a contract has; write a module for it")
    if name != "TanhNormal":
        return {"step": Layers(layers, Spread(extractor)), "distribution": "diagonal-normal"}
    if given.get("tanh_loc"):
        raise Refused("actor", actor, "TanhNormal with tanh_loc; write a module for it")
    ends = []
    for end, other in (("low", -1.0), ("high", 1.0)):
        # One for each robot of a team, and one for all axes or for each.
        each = torch.as_tensor(given.get(end, other), dtype=torch.float32).cpu()
        rows = each.expand(1, 2) if each.dim() == 0 else each.reshape(-1, each.shape[-1]).expand(-1, 2)
        if not (rows == rows[0]).all():
            raise Refused("actor", head, f"its '{end}' is another one for each robot")
        ends.append(rows[0].clone())
    limit = round(float(torch.stack(ends).abs().max()), 6)
    return {"step": Layers(layers, Network(Means(), squash=(ends[0], ends[1]))), "distribution": "none", "limit": limit}


class Layers(nn.Module):
    """Layers of an actor one after the other, some of which have a state.

    Attributes:
        state_floats: Number of floats of all states together.
    """

    def __init__(self, layers: Sequence[Any], end: nn.Module):
        super().__init__()
        self.layers, self.end = nn.ModuleList(), end
        for layer in layers:
            if type(layer).__name__ in MEMORY:
                self.layers.append(Memory(layer))
                self.layers.extend(_parts(layer.mlp))
            else:
                self.layers.append(layer)
        self.state_floats = sum(layer.floats for layer in self.layers if isinstance(layer, Memory))

    def forward(self, observation: Tensor, state: Tensor | None = None) -> Tensor | tuple[Tensor, Tensor]:
        x, at, later = observation, 0, []
        for layer in self.layers:
            if isinstance(layer, Memory) and state is not None:
                x, after = layer(x, state[:, at : at + layer.floats])
                at += layer.floats
                later.append(after)
            else:
                x = layer(x)
        return self.end(x) if state is None else (self.end(x), torch.cat(later, dim=1))


class Memory(nn.Module):
    """Cells of a model ``Gru`` or ``Lstm`` of BenchMARL.

    Attributes:
        floats: Number of floats of their state.
    """

    def __init__(self, model: Any):
        super().__init__()
        self.is_lstm = type(model).__name__ == "Lstm"
        many = model.lstm if self.is_lstm else model.gru
        if not many.share_params or many.centralised or many.compile:
            why = "weights of each robot's own, those of all observe, or compile=True"
            raise Refused("experiment", model, f"{why}: take share_policy_params, and compile=False")
        empty = many._empty_lstm if self.is_lstm else many._empty_gru
        with many.params.to_module(empty):
            self.cells = copy.deepcopy(empty.lstms if self.is_lstm else empty.grus)
        self.width = model.hidden_size
        self.floats = len(self.cells) * self.width * (2 if self.is_lstm else 1)

    def forward(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        later, parts = [], list(state.split(self.width, dim=1))
        for at, cell in enumerate(self.cells):
            if self.is_lstm:
                x, inner = cell(x, (parts[2 * at], parts[2 * at + 1]))
                later += [x, inner]
            else:
                x = cell(x, parts[at])
                later.append(x)
        return x, torch.cat(later, dim=1)


class Spread(nn.Module):
    """Means and log standard deviations of what a ``NormalParamExtractor`` takes."""

    def __init__(self, extractor: nn.Module):
        super().__init__()
        self.extractor = extractor

    def forward(self, out: Tensor) -> Tensor:
        mean, deviation = self.extractor(out)
        return torch.cat([mean, deviation.log()], dim=1)


class Means(nn.Module):
    """Means of what a ``NormalParamExtractor`` takes."""

    def forward(self, out: Tensor) -> Tensor:
        mean, _ = out.chunk(2, dim=1)
        return mean
