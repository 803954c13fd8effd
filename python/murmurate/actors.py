"""Actors of other trainers as arguments of :func:`murmurate.export_graph`: module, normalisation, frames and limits.

Needs PyTorch. Each function takes what the trainer has made, asks it for some actions, and compares them.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from ._actors import _parts
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
    choices, give their velocities to ``export_graph`` as ``choices``.

    Args:
        model: Model with the policy "MlpPolicy".
        env: Environment with the ``VecNormalize`` and ``VecFrameStack`` of the training; None takes that of the model.
    """
    policy, space = model.policy, model.action_space
    try:
        network, options = _sb3_network(policy, space)
        env = model.get_env() if env is None else env
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
        inside = vars(env).get("venv") if env is not None else None
        if inside is None:
            break
        env = inside
    return frames, inner, outer


def _below(env: Any) -> list[Any]:
    """Returns the environments within a wrapper of Stable-Baselines3."""
    found = []
    while vars(env).get("venv") is not None and len(found) < 100:
        env = env.venv
        found.append(env)
    return found


def torchrl(actor: Any) -> dict[str, Any]:
    """Returns an actor of TorchRL, for one robot, as arguments of ``export_graph``.

    Taken is a ``ProbabilisticActor`` with one input whose last parts are ``NormalParamExtractor`` and ``IndependentNormal`` or
    ``TanhNormal``, or ``Categorical`` or ``OneHotCategorical`` of logits, for which ``export_graph`` needs ``choices``.
    """
    parts = list(_parts(actor))
    if not parts or not hasattr(parts[-1], "distribution_class"):
        raise ValueError(f"actor: {type(actor).__name__}: it does not end with the distribution of its actions")
    head, layers = parts[-1], parts[:-1]
    name, given = head.distribution_class.__name__, dict(head.distribution_kwargs)
    if name in ("Categorical", "OneHotCategorical"):
        return {"step": Network(nn.Sequential(*layers)), "action": "choice"}
    if type(layers[-1]).__name__ != "NormalParamExtractor" or name not in ("IndependentNormal", "Normal", "TanhNormal"):
        raise ValueError(f"actor: {type(actor).__name__}: its distribution {name} is none that a contract has; write a module for it")
    spread = Spread(nn.Sequential(*layers[:-1]), layers[-1])
    if name != "TanhNormal":
        return {"step": spread, "distribution": "diagonal-normal"}
    if given.get("tanh_loc"):
        raise ValueError("actor: TanhNormal with tanh_loc; write a module for it")
    low, high = (torch.as_tensor(given.get(end, other), dtype=torch.float32) for end, other in (("low", -1.0), ("high", 1.0)))
    ends = low.expand(2).clone(), high.expand(2).clone()
    return {"step": Network(Means(spread), squash=ends), "distribution": "none", "limit": round(float(high.max()), 6)}


class Spread(nn.Module):
    """Means and log standard deviations of a network and its ``NormalParamExtractor``."""

    def __init__(self, network: nn.Module, extractor: nn.Module):
        super().__init__()
        self.network, self.extractor = network, extractor

    def forward(self, observation: Tensor) -> Tensor:
        mean, deviation = self.extractor(self.network(observation))
        return torch.cat([mean, deviation.log()], dim=1)


class Means(nn.Module):
    """Means of a network that also has deviations."""

    def __init__(self, network: Spread):
        super().__init__()
        self.network = network

    def forward(self, observation: Tensor) -> Tensor:
        mean, _ = self.network.network(observation).chunk(2, dim=1)
        return mean
