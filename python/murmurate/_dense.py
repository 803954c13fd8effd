"""Convolutions of PyTorch Geometric for one robot and its neighbours, in places of which some are empty.

Needs PyTorch, so it is imported where it is used.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import torch
from torch import Tensor, nn

from ._hops import Refused

#: Score of an empty place before it is left out of a maximum.
_LEAST = -1e30


@dataclasses.dataclass
class Heard:
    """What robots have heard.

    Attributes:
        vectors: Inputs of neighbours, one tensor [R, K, W] for each round of messages that a convolution needs.
        mask: 1 for a neighbour, 0 for an empty place [R, K].
        edges: Features of the edges [R, K, E].
        degrees: Number of neighbours that each neighbour has heard in its last step [R, K].
    """

    vectors: list[Tensor]
    mask: Tensor
    edges: Tensor
    degrees: Tensor

    def with_self(self, own: Tensor, edge: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """Returns vectors, mask and edges, among which the robot is its own neighbour with this edge."""
        edge = self.edges.sum(1) * 0.0 if edge is None else edge
        vectors = torch.cat([self.vectors[0], own.unsqueeze(1)], dim=1)
        mask = torch.cat([self.mask, torch.ones_like(self.mask[:, :1])], dim=1)
        return vectors, mask, torch.cat([self.edges, edge.unsqueeze(1)], dim=1)


class Dense(nn.Module):
    """Convolution for one robot and its neighbours.

    Attributes:
        rounds: Number of vectors that a neighbour has to send for it.
        degrees: Whether it needs the numbers of neighbours of neighbours.
    """

    rounds = 1
    degrees = False

    def __init__(self, conv: Any, loops: bool):
        super().__init__()
        self.conv, self.loops = conv, loops

    def forward(self, own: Tensor, heard: Heard) -> tuple[Tensor, list[Tensor]]:
        """Returns the output [R, W'], and what neighbours need of it for further rounds."""
        vectors, mask, edges = heard.vectors[0], heard.mask, heard.edges
        if self.loops:
            vectors, mask, edges = heard.with_self(own, self.loop_edge(heard))
        return self.of(own, vectors, mask, edges), []

    def loop_edge(self, heard: Heard) -> Tensor | None:
        """Returns the features of the edge from a robot to itself; None for zeros."""
        return None

    def of(self, own: Tensor, vectors: Tensor, mask: Tensor, edges: Tensor) -> Tensor:
        """Returns the output for neighbours that may include the robot itself."""
        raise NotImplementedError


def _aggregated(kind: str, values: Tensor, mask: Tensor) -> Tensor:
    """Returns the sum, mean or maximum over the neighbours; zero without any."""
    there = mask.unsqueeze(-1)
    if kind == "max":
        largest = torch.where(there > 0, values, torch.full_like(values, _LEAST)).amax(1)
        return torch.where(mask.sum(1, keepdim=True) > 0, largest, torch.zeros_like(largest))
    total = (values * there).sum(1)
    return total / mask.sum(1, keepdim=True).clamp(min=1.0) if kind == "mean" else total


def _softmax(score: Tensor, mask: Tensor) -> Tensor:
    """Returns weights [R, K, H] that have the sum 1 over the neighbours; zeros without any."""
    there = mask.unsqueeze(-1)
    largest = torch.where(there > 0, score, torch.full_like(score, _LEAST)).amax(1, keepdim=True)
    weight = torch.exp((score - largest) * there) * there
    return weight / weight.sum(1, keepdim=True).clamp(min=1e-6)


class _Graph(Dense):
    def of(self, own: Tensor, vectors: Tensor, mask: Tensor, edges: Tensor) -> Tensor:
        conv = self.conv
        return conv.lin_rel(_aggregated(_kind(conv), vectors, mask)) + conv.lin_root(own)


class _Sage(Dense):
    def of(self, own: Tensor, vectors: Tensor, mask: Tensor, edges: Tensor) -> Tensor:
        conv = self.conv
        out = conv.lin_l(_aggregated(_kind(conv), conv.lin(vectors).relu() if conv.project else vectors, mask))
        out = out + conv.lin_r(own) if conv.root_weight else out
        return nn.functional.normalize(out, dim=-1) if conv.normalize else out


class _Edge(Dense):
    def of(self, own: Tensor, vectors: Tensor, mask: Tensor, edges: Tensor) -> Tensor:
        here = own.unsqueeze(1).expand_as(vectors)
        return _aggregated(_kind(self.conv), self.conv.nn(torch.cat([here, vectors - here], dim=-1)), mask)


class _Gin(Dense):
    def of(self, own: Tensor, vectors: Tensor, mask: Tensor, edges: Tensor) -> Tensor:
        conv = self.conv
        if getattr(conv, "lin", None) is not None:
            vectors = (vectors + conv.lin(edges)).relu()
        return conv.nn((1.0 + conv.eps) * own + _aggregated(_kind(conv), vectors, mask))


class _Attention(Dense):
    """Attention with self-loops, whose edge is the mean of the others."""

    def __init__(self, conv: Any, loops: bool):
        super().__init__(conv, loops or getattr(conv, "add_self_loops", False))

    def loop_edge(self, heard: Heard) -> Tensor | None:
        return _aggregated("mean", heard.edges, heard.mask) if getattr(self.conv, "add_self_loops", False) else None

    def joined(self, own: Tensor, values: Tensor, weight: Tensor) -> Tensor:
        """Returns the heads of the weighted values, one after the other or their mean, and what is added to them."""
        conv = self.conv
        heads = (weight.unsqueeze(-1) * values).sum(1)
        out = heads.flatten(1) if conv.concat else heads.mean(1)
        out = out if getattr(conv, "res", None) is None else out + conv.res(own)
        return out if getattr(conv, "bias", None) is None else out + conv.bias

    def heads(self, values: Tensor) -> Tensor:
        """Returns values [..., H * C] as [..., H, C]."""
        return values.unflatten(-1, (self.conv.heads, self.conv.out_channels))


class _Gat(_Attention):
    def of(self, own: Tensor, vectors: Tensor, mask: Tensor, edges: Tensor) -> Tensor:
        conv = self.conv
        sender, receiver = (conv.lin, conv.lin) if conv.lin is not None else (conv.lin_src, conv.lin_dst)
        values = self.heads(sender(vectors))
        score = (values * conv.att_src).sum(-1) + (self.heads(receiver(own)) * conv.att_dst[0]).sum(-1).unsqueeze(1)
        if conv.lin_edge is not None:
            score = score + (self.heads(conv.lin_edge(edges)) * conv.att_edge).sum(-1)
        return self.joined(own, values, _softmax(nn.functional.leaky_relu(score, conv.negative_slope), mask))


class _Gatv2(_Attention):
    def of(self, own: Tensor, vectors: Tensor, mask: Tensor, edges: Tensor) -> Tensor:
        conv = self.conv
        values = self.heads(conv.lin_l(vectors))
        both = values + self.heads(conv.lin_r(own)).unsqueeze(1)
        if conv.lin_edge is not None:
            both = both + self.heads(conv.lin_edge(edges))
        score = (nn.functional.leaky_relu(both, conv.negative_slope) * conv.att).sum(-1)
        return self.joined(own, values, _softmax(score, mask))


class _Transformer(_Attention):
    def of(self, own: Tensor, vectors: Tensor, mask: Tensor, edges: Tensor) -> Tensor:
        conv = self.conv
        values, key = self.heads(conv.lin_value(vectors)), self.heads(conv.lin_key(vectors))
        if conv.lin_edge is not None:
            more = self.heads(conv.lin_edge(edges))
            values, key = values + more, key + more
        query = self.heads(conv.lin_query(own)).unsqueeze(1)
        out = self.joined(own, values, _softmax((query * key).sum(-1) / conv.out_channels**0.5, mask))
        if not conv.root_weight:
            return out
        own = conv.lin_skip(own)
        if conv.lin_beta is None:
            return out + own
        share = conv.lin_beta(torch.cat([out, own, out - own], dim=-1)).sigmoid()
        return share * own + (1.0 - share) * out


class _Degrees(Dense):
    """Convolution that weighs an edge by the numbers of neighbours at both ends."""

    degrees = True

    def __init__(self, conv: Any, loops: bool):
        super().__init__(conv, loops)
        self.degrees = conv.normalize
        own = getattr(conv, "add_self_loops", False)
        self.loop = 1.0 if loops or own else 0.0

    def step(self, own: Tensor, vectors: Tensor, heard: Heard) -> Tensor:
        """Returns the sum over neighbours, and the robot itself if it is one."""
        if not self.conv.normalize:
            return _aggregated("sum", vectors, heard.mask) + self.loop * own
        here, there = _root(heard.mask.sum(1, keepdim=True) + self.loop), _root(heard.degrees + self.loop)
        return here * (_aggregated("sum", there.unsqueeze(-1) * vectors, heard.mask) + self.loop * here * own)


def _root(degree: Tensor) -> Tensor:
    """Returns 1 / sqrt(degree), and 0 of 0."""
    return torch.where(degree > 0, degree.clamp(min=1.0).rsqrt(), torch.zeros_like(degree))


class _Gcn(_Degrees):
    def forward(self, own: Tensor, heard: Heard) -> tuple[Tensor, list[Tensor]]:
        out = self.conv.lin(self.step(own, heard.vectors[0], heard))
        return (out if self.conv.bias is None else out + self.conv.bias), []


class _Tag(_Degrees):
    def __init__(self, conv: Any, loops: bool):
        super().__init__(conv, loops)
        self.rounds = conv.K

    def forward(self, own: Tensor, heard: Heard) -> tuple[Tensor, list[Tensor]]:
        lins, sent, here = list(self.conv.lins), [], own
        out = lins[0](own)
        for lin, vectors in zip(lins[1:], heard.vectors):
            here = self.step(here, vectors, heard)
            out = out + lin(here)
            sent.append(here)
        return (out if self.conv.bias is None else out + self.conv.bias), sent[:-1]


#: Convolutions by their names.
CONVOLUTIONS: dict[str, type[Dense]] = {
    "EdgeConv": _Edge,
    "GATConv": _Gat,
    "GATv2Conv": _Gatv2,
    "GCNConv": _Gcn,
    "GINConv": _Gin,
    "GINEConv": _Gin,
    "GraphConv": _Graph,
    "SAGEConv": _Sage,
    "TAGConv": _Tag,
    "TransformerConv": _Transformer,
}


def _kind(conv: Any) -> str:
    return {"add": "sum"}.get(str(conv.aggr), str(conv.aggr))


def dense(conv: nn.Module, loops: bool, argument: str) -> Dense:
    """Returns a convolution for one robot and its neighbours. With ``loops`` a robot is one of its own neighbours."""
    name = type(conv).__name__
    if name not in CONVOLUTIONS:
        known = ", ".join(CONVOLUTIONS)
        raise Refused(argument, conv, f"it is none of {known}; write it for messages [R, K, M] and export_graph(encode=, act=)")
    if _kind(conv) not in ("sum", "mean", "max") or (CONVOLUTIONS[name] in (_Gcn, _Tag) and _kind(conv) != "sum"):
        raise Refused(argument, conv, f"its aggregation '{getattr(conv, 'aggr', None)}' is none of add, mean and max")
    if getattr(conv, "improved", False):
        raise Refused(argument, conv, "improved=True: what its self-loops weigh depends on the version of PyTorch Geometric")
    if getattr(conv, "fill_value", "mean") != "mean":
        raise Refused(argument, conv, "the edge of its self-loops is not the mean of the others")
    return CONVOLUTIONS[name](conv, loops)
