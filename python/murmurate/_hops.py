"""PyTorch modules as networks and hops of a policy file: which can be written, and the exact layers of each."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import Tensor, nn


class Refused(Exception):
    """Error of a module that a policy file cannot hold; it names the argument of ``export``, the module and the reason."""

    def __init__(self, argument: str, module: nn.Module | None, why: str):
        super().__init__(f"{argument}: {'' if module is None else type(module).__name__ + ': '}{why}")


class Inexact(Refused):
    """Error of a module that a policy file cannot hold, but perhaps a graph (format 3)."""


def ACTIVATIONS() -> tuple[type, ...]:
    """Types of the activations that a policy file can hold."""
    from torch import nn

    return (nn.ReLU, nn.Tanh, nn.ELU, nn.LeakyReLU)


def activation_of(module: nn.Module, argument: str) -> Any:
    """Returns an activation as the manifest names it."""
    from torch import nn

    match module:
        case nn.ReLU():
            return "relu"
        case nn.Tanh():
            return "tanh"
        case nn.ELU() if module.alpha == 1:
            return "elu"
        case nn.LeakyReLU():
            return {"leaky-relu": module.negative_slope}
    raise Refused(argument, module, "no such activation; there are ReLU, Tanh, ELU with alpha 1 and LeakyReLU")


def flat(module: nn.Module) -> list[nn.Module]:
    """Returns the modules of nested sequences, without those that do nothing after a training."""
    from torch import nn

    if isinstance(module, nn.Sequential):
        return [part for inner in module for part in flat(inner)]
    return [] if isinstance(module, (nn.Identity, nn.Dropout)) else [module]


def linear(module: nn.Linear) -> tuple[Tensor, Tensor]:
    """Returns weight and bias of a linear layer; zeros for a bias that it does not have."""
    bias = module.weight.new_zeros(module.weight.shape[0]) if module.bias is None else module.bias
    return module.weight, bias


def network_of(module: nn.Module, argument: str) -> tuple[dict[str, Any], list[tuple[Tensor, Tensor]]]:
    """Returns the form and the layers of a network of linear layers with one kind of activation between them.

    The form is its entry in the manifest: widths and activations. A layer is a pair of a weight (out, in) and a bias (out).
    """
    from torch import nn

    parts, layers, between, after = flat(module), [], [], None
    for at, part in enumerate(parts):
        if isinstance(part, nn.Linear):
            if after is not None:
                between.append(after)
                after = None
            elif layers:
                raise Inexact(argument, part, "no activation stands before it; join the two layers")
            layers.append(linear(part))
        elif not isinstance(part, ACTIVATIONS()):
            raise Inexact(argument, part, "it is neither Linear nor an activation (ReLU, Tanh, ELU, LeakyReLU)")
        elif not layers or after is not None:
            raise Inexact(argument, part, "an activation that does not follow a linear layer; put it behind the one before")
        else:
            after = activation_of(part, argument)
    if not layers:
        raise Inexact(argument, module, "it has no linear layer")
    if any(one != between[0] for one in between):
        raise Inexact(argument, module, "its activations differ; a policy file has one kind in a network")
    form: dict[str, Any] = {"widths": [layers[0][0].shape[1], *(weight.shape[0] for weight, _ in layers)]}
    if between:
        form["activation"] = between[0]
    if after is not None:
        form["output_activation"] = after
    return form, layers


def followed(
    form: dict[str, Any], layers: list[tuple[Tensor, Tensor]], after: nn.Module, argument: str
) -> tuple[dict[str, Any], list[tuple[Tensor, Tensor]]]:
    """Returns one network for a network, of this form and these layers, and the module ``after`` on its outputs.

    Form (an entry of the manifest) and layers are as :func:`network_of` returns them.
    """
    more, behind = network_of(after, argument)
    takes, gives = more["widths"][0], layers[-1][0].shape[0]
    if takes != gives:
        raise Refused(argument, after, f"it takes {takes} floats, and the convolution before it gives {gives}")
    between = form.get("output_activation")
    if between is None:
        # Two linear layers without an activation between them are one.
        (weight, bias), (last, last_bias) = behind[0], layers[-1]
        layers, behind = layers[:-1], [(weight @ last, weight @ last_bias + bias), *behind[1:]]
    kinds = [form.get("activation"), more.get("activation"), between]
    kinds = [kind for kind in kinds if kind is not None]
    if any(kind != kinds[0] for kind in kinds):
        raise Inexact(argument, after, "its activations differ from those of the convolution before it")
    layers = layers + behind
    joined = {"inputs": form["inputs"], "widths": [form["widths"][0], *(weight.shape[0] for weight, _ in layers)]}
    if len(layers) > 1:
        joined["activation"] = kinds[0]
    if "output_activation" in more:
        joined["output_activation"] = more["output_activation"]
    return joined, layers


def edges_of(conv: Any) -> int:
    """Returns how many features of an edge a convolution takes."""
    layer = getattr(conv, "lin", None) if type(conv).__name__ == "GINEConv" else getattr(conv, "lin_edge", None)
    return 0 if layer is None else layer.weight.shape[1]


def hop_of(conv: nn.Module, width: int, edge: int, argument: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns the entry of the manifest for a convolution as a hop, and the layers of each of its networks by name.

    ``width`` is the number of floats of a robot's input, ``edge`` that of an edge's features.
    """
    known: dict[str, Callable[..., Any]] = {
        "GraphConv": _graph_conv,
        "GATv2Conv": _gatv2_conv,
        "GINEConv": _gine_conv,
        "TransformerConv": _transformer_conv,
        "EdgeConv": _edge_conv,
        "GATConv": _gat_conv,
        "SAGEConv": _sage_conv,
    }
    if type(conv).__name__ not in known:
        raise Inexact(argument, conv, f"it is none of {', '.join(known)}, nor an activation")
    takes = getattr(conv, "in_channels", width)
    if takes not in (width, (width, width)):
        raise Refused(argument, conv, f"it takes {takes} floats of a robot, and what is before it gives {width}")
    return known[type(conv).__name__](conv, (width, edge), argument)


def _refuse(argument: str, conv: nn.Module, **wrong: bool) -> None:
    for why, is_so in wrong.items():
        if is_so:
            raise Inexact(argument, conv, f"a policy file does not hold {why.replace('__', '=').replace('_', ' ')}")


def _beside(*blocks: Tensor) -> Tensor:
    """Returns one matrix for inputs that lie one after the other."""
    import torch

    return torch.cat(blocks, dim=1)


def _aggregation(conv: nn.Module, argument: str) -> str:
    aggregation = {"add": "sum", "sum": "sum", "mean": "mean", "max": "max"}.get(str(conv.aggr))
    if aggregation is None:
        raise Inexact(argument, conv, f"its aggregation '{conv.aggr}' is none of add, mean and max")
    return aggregation


def _graph_conv(conv: Any, _: tuple[int, int], argument: str) -> Any:
    out, width = conv.lin_root.weight.shape
    weight, bias = linear(conv.lin_rel)
    form = {
        "aggregation": _aggregation(conv, argument),
        "update": {"inputs": ["own", "messages"], "widths": [2 * width, out]},
    }
    return form, {"update": [(_beside(conv.lin_root.weight, weight), bias)]}


def _edges(conv: Any, layer: Any, edge: int, argument: str) -> Any:
    """Returns the weight of the layer for the edges' features, without columns if there are none."""
    takes = 0 if layer is None else layer.weight.shape[1]
    if takes != edge:
        raise Refused(argument, conv, f"it takes {takes} features of an edge, and 'edge' has {edge}")
    return None if layer is None else layer.weight


def _sage_conv(conv: Any, _: tuple[int, int], argument: str) -> Any:
    _refuse(argument, conv, project__True=conv.project, normalize__True=conv.normalize)
    weight, bias = linear(conv.lin_l)
    own = conv.lin_r.weight if conv.root_weight else weight.new_zeros(weight.shape)
    form = {
        "aggregation": _aggregation(conv, argument),
        "update": {"inputs": ["own", "messages"], "widths": [2 * weight.shape[1], weight.shape[0]]},
    }
    return form, {"update": [(_beside(own, weight), bias)]}


def _edge_conv(conv: Any, size: tuple[int, int], argument: str) -> Any:
    import torch

    width = size[0]
    message, layers = network_of(conv.nn, f"{argument}.nn")
    if message["widths"][0] != 2 * width:
        raise Refused(f"{argument}.nn", conv.nn, f"it takes {message['widths'][0]} floats, and both robots have {2 * width}")
    weight, bias = layers[0]
    # It takes the own input and the difference to the sender's.
    layers[0] = (_beside(weight[:, :width] - weight[:, width:], weight[:, width:]), bias)
    out = message["widths"][-1]
    form = {
        "message": {**message, "inputs": ["own", "sender"]},
        "aggregation": _aggregation(conv, argument),
        "update": {"inputs": ["messages"], "widths": [out, out]},
    }
    return form, {"message": layers, "update": [(torch.eye(out), bias.new_zeros(out))]}


def _gat_conv(conv: Any, size: tuple[int, int], argument: str) -> Any:
    _refuse(argument, conv, weights_of_senders_and_receivers_apart=conv.lin is None)
    of_edge = _edges(conv, conv.lin_edge, size[1], argument)

    def scores(attention: Any, weight: Any) -> Any:
        # The score of a head takes the values of that head only.
        return (attention[0].unsqueeze(2) * weight.unflatten(0, attention.shape[1:])).sum(1)

    weight, bias = linear(conv.lin)
    first = [scores(conv.att_dst, weight), scores(conv.att_src, weight)]
    first += [] if of_edge is None else [scores(conv.att_edge, of_edge)]
    score = {"widths": [2 * size[0] + size[1], conv.heads], "output_activation": {"leaky-relu": conv.negative_slope}}
    return _attention(conv, size, argument, score, (weight, bias), [(_beside(*first), weight.new_zeros(conv.heads))])


def _gatv2_conv(conv: Any, size: tuple[int, int], argument: str) -> Any:
    import torch

    of_edge = _edges(conv, conv.lin_edge, size[1], argument)
    hidden = conv.lin_l.weight.shape[0]
    (left, left_bias), (right, right_bias) = linear(conv.lin_l), linear(conv.lin_r)
    first = _beside(right, left) if of_edge is None else _beside(right, left, of_edge)
    # The score of a head takes the values of that head only.
    last = torch.block_diag(*conv.att[0].unsqueeze(1))
    score = {"widths": [2 * size[0] + size[1], hidden, conv.heads], "activation": {"leaky-relu": conv.negative_slope}}
    layers = [(first, right_bias + left_bias), (last, left.new_zeros(conv.heads))]
    return _attention(conv, size, argument, score, (left, left_bias), layers)


def _attention(conv: Any, size: tuple[int, int], argument: str, score: dict[str, Any], message: Any, layers: Any) -> Any:
    """Returns a hop of attention by a score: the form and the layers of the score, and the one layer of the message."""
    import torch

    one_head, edge = conv.heads == 1, size[1]
    _refuse(argument, conv, concat__False=not (conv.concat or one_head), residual__True=getattr(conv, "res", None) is not None)
    hidden = message[0].shape[0]
    form: dict[str, Any] = {
        "message": {"inputs": ["sender"], "widths": [size[0], hidden]},
        "aggregation": "softmax",
        "heads": conv.heads,
        "score": {"inputs": ["own", "sender", "edge"][: 3 if edge else 2], **score},
        "update": {"inputs": ["messages"], "widths": [hidden, hidden]},
    }
    if conv.add_self_loops:
        _refuse(argument, conv, other_fill_values_than_the_mean=edge > 0 and conv.fill_value != "mean")
        form["self_loop"] = "mean-edge" if edge else "zero-edge"
    bias = message[0].new_zeros(hidden) if conv.bias is None else conv.bias
    return form, {"message": [message], "score": layers, "update": [(torch.eye(hidden), bias)]}


def _gine_conv(conv: Any, size: tuple[int, int], argument: str) -> Any:
    import torch

    width, edge = size
    update, layers = network_of(conv.nn, f"{argument}.nn")
    if update["widths"][0] != width:
        raise Refused(f"{argument}.nn", conv.nn, f"it takes {update['widths'][0]} floats, and what is before it gives {width}")
    of_edge = _edges(conv, conv.lin, edge, argument)
    if of_edge is None:
        raise Inexact(argument, conv, "it needs edge_dim, the number of features of an edge")
    message = (_beside(torch.eye(width), of_edge), linear(conv.lin)[1])
    weight, bias = layers[0]
    layers[0] = (_beside((1 + conv.eps) * weight, weight), bias)
    update = {**update, "inputs": ["own", "messages"], "widths": [2 * width, *update["widths"][1:]]}
    form = {
        "message": {"inputs": ["sender", "edge"], "widths": [width + edge, width], "output_activation": "relu"},
        "aggregation": _aggregation(conv, argument),
        "update": update,
    }
    return form, {"message": [message], "update": layers}


def _transformer_conv(conv: Any, size: tuple[int, int], argument: str) -> Any:
    import torch

    one_head = conv.heads == 1
    _refuse(
        argument,
        conv,
        concat__False=not (conv.concat or one_head),
        beta__True=getattr(conv, "lin_beta", None) is not None,
        root_weight__False=not conv.root_weight,
    )
    width, edge = size
    of_edge = _edges(conv, conv.lin_edge, edge, argument)
    hidden = conv.lin_value.weight.shape[0]

    def sent(layer: Any) -> Any:
        weight, bias = linear(layer)
        return [(weight if of_edge is None else _beside(weight, of_edge), bias)]

    inputs = {"inputs": ["sender"] if of_edge is None else ["sender", "edge"], "widths": [width + edge, hidden]}
    skip, skip_bias = linear(conv.lin_skip)
    form = {
        "message": inputs,
        "aggregation": "dot-product",
        "heads": conv.heads,
        "query": {"inputs": ["own"], "widths": [width, hidden]},
        "key": inputs,
        "update": {"inputs": ["own", "messages"], "widths": [width + hidden, hidden]},
    }
    networks = {
        "message": sent(conv.lin_value),
        "query": [linear(conv.lin_query)],
        "key": sent(conv.lin_key),
        "update": [(_beside(skip, torch.eye(hidden)), skip_bias)],
    }
    return form, networks


def checked(module: Any, argument: str) -> nn.Module:
    """Returns a module if its weights can be written: those of a module on another device from a copy on the processor.

    Raises:
        Refused: It is no module, or its weights are not made yet, not of single precision, not finite, or without numbers.
    """
    import copy

    from torch import float32, nn
    from torch.nn.parameter import is_lazy

    if not isinstance(module, nn.Module):
        name = getattr(module, "__name__", type(module).__name__)
        raise Refused(argument, None, f"{name} is no module of PyTorch (torch.nn.Module)")
    for name, parameter in module.named_parameters():
        if is_lazy(parameter):
            raise Refused(argument, module, f"'{name}' has no size yet; run the module once")
        if parameter.is_meta:
            raise Refused(argument, module, f"'{name}' is on the device 'meta', where it has no numbers; load it to 'cpu'")
        if parameter.dtype != float32:
            raise Refused(argument, module, f"'{name}' is {parameter.dtype}, a policy file has float32; export {argument}.float()")
        if not parameter.isfinite().all():
            raise Refused(argument, module, f"'{name}' has numbers that are not finite")
    if all(parameter.device.type == "cpu" for parameter in module.parameters()):
        return module
    return copy.deepcopy(module).cpu()


@contextlib.contextmanager
def evaluated(modules: Sequence[nn.Module]) -> Iterator[None]:
    """Puts modules into evaluation for the block, and each of their parts back as it was."""
    parts = {part: part.training for module in modules for part in module.modules()}
    for module in modules:
        module.eval()
    try:
        yield
    finally:
        for part, training in parts.items():
            part.training = training


def applied(module: nn.Module, argument: str, *inputs: Any) -> Any:
    """Returns what a module makes of these inputs.

    Raises:
        Refused: It cannot take them.
    """
    try:
        return module(*inputs)
    except Exception as error:
        sizes = " and ".join(str(list(one.shape)) for one in inputs)
        raise Refused(argument, module, f"it does not take inputs of {sizes}: {str(error).splitlines()[0]}") from None
