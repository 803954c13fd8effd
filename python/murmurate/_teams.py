"""Encoder, convolutions and decoder as the two graphs of a policy: ``encode`` for the message, and ``act`` for the action.

Needs PyTorch, so it is imported where it is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from ._actors import SOFTPLUS_BIAS, Actor
from ._dense import CONVOLUTIONS, Dense, Heard, dense
from ._hops import Refused, applied, edges_of


class Stages(nn.Module):
    """Convolutions, each with the layers that follow it.

    Attributes:
        kept: Numbers of floats of what is sent beside the encoder's output; it was computed in the step before.
        degrees: Whether the number of heard neighbours is sent, too.
        state_floats: Number of floats that are kept from one step to the next.
    """

    def __init__(self, parts: Sequence[nn.Module], loops: set[int], width: int, edge: int):
        super().__init__()
        self.convolutions, self.after = nn.ModuleList(), nn.ModuleList()
        self.width, self.takes_edges = width, []
        for at, part in enumerate(parts):
            if hasattr(part, "aggr_module") or type(part).__name__ in CONVOLUTIONS:
                self.convolutions.append(dense(part, len(self.convolutions) in loops, f"hops[{at}]"))
                self.after.append(nn.Sequential())
                needs = edges_of(part)
                if needs not in (0, edge):
                    raise Refused(f"hops[{at}]", part, f"it takes {needs} features of an edge, and 'edge' has {edge}")
                self.takes_edges.append(needs > 0)
            elif not self.after:
                raise Refused(f"hops[{at}]", part, "it stands before the first convolution; end the encoder with it")
            else:
                self.after[-1].append(part)
        self.degrees = any(conv.degrees for conv in self.convolutions)
        self.kept: list[int] = []
        vectors = torch.zeros(1, width)
        for at, (conv, after) in enumerate(zip(self.convolutions, self.after)):
            rounds = [torch.zeros(1, 1, vectors.shape[1])] * conv.rounds
            heard = Heard(rounds, torch.ones(1, 1), torch.zeros(1, 1, edge if self.takes_edges[at] else 0), torch.ones(1, 1))
            self.kept += ([vectors.shape[1]] if at else []) + [vectors.shape[1]] * (conv.rounds - 1)
            vectors = after(applied(conv, f"hops[{at}]", vectors, heard)[0])
        self.out = vectors.shape[1]
        self.state_floats = sum(self.kept) + self.degrees

    def forward(self, own: Tensor, messages: Tensor, edges: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the output of the last stage, and what is sent of it in the next step."""
        vectors = list(messages.split([self.width, *self.kept, *([1] if self.degrees else [])], dim=2))
        degrees = vectors.pop().squeeze(2) if self.degrees else mask
        here, later = own, []
        for at, (conv, after) in enumerate(zip(self.convolutions, self.after)):
            assert isinstance(conv, Dense)
            some, vectors = vectors[: conv.rounds], vectors[conv.rounds :]
            later += [here] if at else []
            here, sent = conv(here, Heard(some, mask, edges if self.takes_edges[at] else edges[:, :, :0], degrees))
            later += sent
            here = after(here)
        later += [mask.sum(1, keepdim=True)] if self.degrees else []
        return here, torch.cat(later, dim=1) if later else own[:, :0]


class Encode(nn.Module):
    """Message of a robot: the encoder's output, and what it computed of messages in the step before."""

    def __init__(self, encoder: nn.Module, stages: Stages):
        super().__init__()
        self.encoder, self.state_floats = encoder, stages.state_floats

    def forward(self, observation: Tensor, state: Tensor | None = None) -> Tensor:
        own = self.encoder(observation)
        return own if state is None else torch.cat([own, state], dim=1)


class Act(nn.Module):
    """Action of a robot from its own message and those of its neighbours."""

    def __init__(self, stages: Stages, head: Head):
        super().__init__()
        self.stages, self.head, self.state_floats = stages, head, stages.state_floats

    def forward(
        self, own_message: Tensor, messages: Tensor, heard: Tensor, edges: Tensor | None = None, state: Tensor | None = None
    ) -> tuple[Tensor, ...]:
        edges = messages[:, :, :0] if edges is None else edges
        out, later = self.stages(own_message[:, : self.stages.width], messages, edges, heard)
        if state is None:
            return (self.head(out),)
        # The graph has to take the state, which is in the robot's own message already.
        return self.head(out) + 0.0 * state.sum(1, keepdim=True), later


class Step(nn.Module):
    """Action of a robot without messages."""

    def __init__(self, encoder: nn.Module, head: Head):
        super().__init__()
        self.encoder, self.head = encoder, head

    def forward(self, observation: Tensor) -> Tensor:
        return self.head(self.encoder(observation))


class Head(nn.Module):
    """Action of the decoder's outputs: the arguments of a normal distribution, or the mean of one within tanh.

    Args:
        decoder: Network with 2 or 4 outputs.
        distribution, deviation: As of ``export``.
        limit: Limit of speed along each axis [m/s].
    """

    def __init__(self, decoder: nn.Module, distribution: str, deviation: str, limit: float):
        super().__init__()
        self.decoder, self.distribution, self.deviation, self.limit = decoder, distribution, deviation, limit

    def forward(self, x: Tensor) -> Tensor:
        out = self.decoder(x)
        if self.distribution == "tanh-normal":
            return self.limit * out[:, :2].tanh()
        if out.shape[1] == 4 and self.deviation == "biased-softplus":
            spread = nn.functional.softplus(out[:, 2:] + SOFTPLUS_BIAS) + 0.01
            return torch.cat([out[:, :2], spread.log()], dim=1)
        return out


def modules_of(actor: Actor, edge: Sequence[str], limit: float, floats: int) -> dict[str, nn.Module]:
    """Returns the modules of the graphs for an actor in parts, whose observation has so many floats."""
    from ._probe import EDGE_WIDTHS

    head = Head(actor.decoder, actor.manifest["distribution"], actor.manifest["deviation"], limit)
    own = applied(actor.encoder, "encoder", torch.zeros(1, floats))
    if not actor.hops:
        last, modules = own, {"step": Step(actor.encoder, head)}
    else:
        stages = Stages(actor.hops, actor.loops, own.shape[1], sum(EDGE_WIDTHS[name] for name in edge))
        last, modules = torch.zeros(1, stages.out), {"encode": Encode(actor.encoder, stages), "act": Act(stages, head)}
    puts = applied(actor.decoder, "decoder", last).shape[1]
    if puts not in (2, 4):
        raise Refused("decoder", actor.decoder, f"it has {puts} outputs; give 2, a velocity, or 4, with its standard deviations")
    return modules


def mean_action(modules: dict[str, Any], observation: Tensor, index: Tensor, edge: Tensor, steps: int = 1) -> Tensor:
    """Returns the action of each robot of a team that stays as it is, after so many steps.

    Args:
        modules: Modules of the graphs.
        observation: What each robot observes (R, F).
        index: Senders and receivers of the messages (2, E).
        edge: Features of the messages' edges (E, D).
    """
    if "step" in modules:
        return modules["step"](observation)
    robots = len(observation)
    mask = torch.zeros(robots, robots)
    edges = torch.zeros(robots, robots, edge.shape[1])
    mask[index[1], index[0]], edges[index[1], index[0]] = 1.0, edge
    encode, act = modules["encode"], modules["act"]
    state = torch.zeros(robots, act.state_floats) if act.state_floats else None
    for _ in range(steps):
        message = encode(observation) if state is None else encode(observation, state)
        messages = message.unsqueeze(0).expand(robots, -1, -1) * mask.unsqueeze(-1)
        out = act(message, messages, mask, edges, state)
        state = out[1] if len(out) > 1 else None
    return out[0]
