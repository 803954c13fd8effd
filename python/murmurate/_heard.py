"""A network of BenchMARL over what agents have heard of each other (``murmurate.benchmarl``)."""

from __future__ import annotations

import copy
import functools
import inspect
from collections.abc import Sequence
from dataclasses import MISSING, dataclass
from typing import Any

import torch
from benchmarl.environments import TaskClass
from benchmarl.models.common import Model, ModelConfig
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs import EnvBase, FlattenObservation, Transform

from .torchrl import Messages, edges_of

#: Keys that the network takes: what each agent observes, and what :class:`murmurate.torchrl.Messages` adds.
KEYS = ("observation", "messages", "heard", "age")


def with_messages(task: TaskClass, *, group: str = "agents", **options: Any) -> TaskClass:
    """Returns a task of BenchMARL whose agents say what they observe, over a :class:`murmurate.Channel`.

    An algorithm of BenchMARL has one action, so that agents choose no message. They say their observation, and a network
    encodes it at the receiver, :class:`HeardGnnConfig`: that is the latent of the sender, by the sender's encoder. Set
    ``bytes`` to the length that the latent has. Models get ``messages`` as (R, R * F)::

        task = with_messages(VmasTask.NAVIGATION.get_from_yaml(), radio="wifi", bytes=168, period_s=0.1)

    Args:
        task: Task of BenchMARL with a batch of environments, such as those of VMAS.
        group: Name of the group of agents.
        options: Further arguments of :class:`murmurate.torchrl.Messages`.
    """
    made = copy.copy(task)
    made.get_env_transforms = functools.partial(_transforms, task, group, options)
    return made


def _transforms(task: TaskClass, group: str, options: dict[str, Any], env: EnvBase) -> list[Transform]:
    messages = Messages(**{"said": "observation", "group": group, **options})
    flat = FlattenObservation(-2, -1, in_keys=[(group, "messages")], allow_positive_dim=True)
    return [*task.get_env_transforms(env), messages, flat]


class HeardGnn(Model):
    """Graph convolution of BenchMARL whose edges are messages: see :class:`HeardGnnConfig`."""

    def __init__(
        self,
        gnn_class: type[nn.Module],
        gnn_kwargs: dict[str, Any] | None,
        num_cells: Sequence[int],
        activation_class: type[nn.Module],
        **arguments: Any,
    ) -> None:
        super().__init__(**arguments)
        at = {(key if isinstance(key, str) else key[-1]): key for key in self.in_keys}
        missing = [key for key in KEYS if key not in at]
        if missing:
            why = "it is for a task by with_messages, and the first model of a sequence"
            raise ValueError(f"input_spec: '{missing[0]}' is missing: {why}")
        self.at = [at[key] for key in KEYS]
        observed, said = (self.input_spec[key].shape[-1] for key in self.at[:2])
        if said != observed * self.n_agents:
            raise ValueError(f"messages: agents observe {observed} floats and say {said / self.n_agents:g}: say 'observation'")
        options = dict(gnn_kwargs or {})
        # The age of a message, where the convolution takes features of edges.
        self.aged = "edge_dim" in inspect.signature(gnn_class).parameters
        if self.aged:
            options["edge_dim"] = 1
        widths = [observed, *num_cells]

        def network() -> nn.ModuleList:
            layers = [layer for a, b in zip(widths, widths[1:]) for layer in (nn.Linear(a, b), activation_class())]
            hop = gnn_class(in_channels=widths[-1], out_channels=self.output_leaf_spec.shape[-1], **options)
            return nn.ModuleList([nn.Sequential(*layers), hop])

        count = 1 if self.share_params else self.n_agents
        self.networks = nn.ModuleList([network().to(self.device) for _ in range(count)])

    def _forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        own, said, heard, age = (tensordict.get(key) for key in self.at)
        heard = heard.bool()
        said = said.unflatten(-1, (self.n_agents, own.shape[-1]))[heard]
        nodes = own.reshape(-1, own.shape[-1])
        # What was heard is a node of its own: it is what its sender has observed then, and not now.
        sender, receiver = edges_of(heard)
        # Each of them is encoded by the agent that has observed it.
        observed = torch.cat([nodes, said])
        observer = torch.cat([torch.arange(len(nodes), device=sender.device), sender]) % self.n_agents
        latents = torch.stack([encode(observed) for encode, _ in self.networks])
        latents = latents[observer % len(self.networks), torch.arange(len(observed), device=sender.device)]
        edges = torch.stack([len(nodes) + torch.arange(len(said), device=said.device), receiver])
        options = {"edge_attr": age[heard].unsqueeze(-1)} if self.aged else {}
        results = []
        for _, hop in self.networks:
            out = hop(latents, edges, **options)
            out = out[: len(nodes)].view(*own.shape[:-1], -1)
            results.append(out.mean(-2) if self.centralised else out)
        if self.share_params:
            out = results[0]
        else:
            out = torch.stack(results if self.centralised else [each[..., at, :] for at, each in enumerate(results)], -2)
        tensordict.set(self.out_key, out)
        return tensordict


@dataclass
class HeardGnnConfig(ModelConfig):
    """Graph network over messages, for tasks by :func:`with_messages`; with a sequence it is the first model.

    Each agent encodes what it observes, and what it has heard others observe as they do, however late that came. A convolution
    of PyTorch Geometric joins both over the messages that an agent has; where it takes features of edges, they have their age::

        model = SequenceModelConfig([HeardGnnConfig(gnn_class=GraphConv), mlp], intermediate_sizes=[32])

    Attributes:
        gnn_class: Convolution of PyTorch Geometric, such as ``GraphConv`` or ``GATv2Conv``.
        gnn_kwargs: Its further arguments.
        num_cells: Widths of the layers of the encoder; none for no encoder.
        activation_class: What follows each of them.
    """

    gnn_class: type[nn.Module] = MISSING
    gnn_kwargs: dict[str, Any] | None = None
    num_cells: Sequence[int] = (32,)
    activation_class: type[nn.Module] = nn.Tanh

    @staticmethod
    def associated_class() -> type[Model]:
        return HeardGnn
