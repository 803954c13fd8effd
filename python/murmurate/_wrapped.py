"""Modules as graphs of a policy: observations put together, normalised and stacked, and outputs by their names.

Needs PyTorch, so it is imported where it is used.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ._contract import ROLES, Contract, Observed
from ._hops import Refused

#: Outputs of each graph, in the order of a tuple.
OUTPUTS = {"step": ("action", "message", "state_next"), "encode": ("message", "state_next"), "act": ("action", "state_next")}
#: Arguments of ``export_graph`` that an input of a graph needs.
GIVE = {"messages": "message=N", "own_message": "message=N", "edges": "edges=[...]", "state": "state=N", "id": "id='one-hot' or 'number'"}
#: Number of robots and of places for neighbours in the example of an export.
EXAMPLE = (3, 5)


def parameters_of(module: nn.Module, argument: str) -> tuple[list[str], list[str]]:
    """Returns the names of a module's parameters: those that need a value, and those that do not."""
    kinds = inspect.Parameter
    needed: list[str] = []
    optional: list[str] = []
    for name, parameter in inspect.signature(module.forward).parameters.items():
        if parameter.kind in (kinds.VAR_POSITIONAL, kinds.VAR_KEYWORD):
            why = f"its forward takes '{parameter}'; give a module whose parameters have the names of what they take"
            raise Refused(argument, module, why)
        (needed if parameter.default is kinds.empty else optional).append(name)
    return needed, optional


class Stack:
    """Frames of each observation, the oldest first.

    Attributes:
        frames: Their number, with the present one.
        copies: Whether frames before the first one are copies of it; else they are zeros.
    """

    def __init__(self, frames: int, copies: bool):
        self.frames, self.copies = frames, copies

    def floats(self, observed: Sequence[Observed]) -> int:
        """Returns the number of floats of state that the frames before the present one take."""
        before = (self.frames - 1) * sum(int(np.prod(each.shape)) for each in observed)
        return before + (self.copies and before > 0)


class Wrapped(nn.Module):
    """Module with the inputs and outputs of a graph.

    Args:
        module: Module of the user, called with keyword arguments.
        role: "step", "encode" or "act".
        contract: Contract of the policy. Its state has the module's own and then the frames before the present one.
        observed: What the module's parameters take of observations.
        norms: Normalisation of such a parameter, by its name.
        stack: Frames of each observation.

    Attributes:
        module: Module of the user.
        inputs, outputs: Names of the tensors of the graph, in their order.
    """

    def __init__(
        self,
        module: nn.Module,
        role: str,
        contract: Contract,
        observed: Sequence[Observed],
        norms: Mapping[str, nn.Module],
        stack: Stack,
    ):
        super().__init__()
        self.module, self.role, self.observed, self.stack = module, role, list(observed), stack
        self.norms = nn.ModuleDict({f"of_{name}": norm for name, norm in norms.items()})
        self.kept = stack.floats(observed)
        self.own_state = contract.state - self.kept
        there = {"messages": contract.message, "own_message": contract.message, "edges": contract.edge_floats}
        there |= {"heard": 1, "state": self.own_state, "id": contract.id_floats}
        needed, optional = parameters_of(module, role)
        self.roles = [name for name in ROLES if name in needed or (name in optional and there[name])]
        for name in self.roles:
            if role == "encode" and name not in ("state", "id"):
                raise Refused(role, module, f"it takes '{name}', and nothing is heard before it; that is for 'act'")
            if not there[name]:
                raise Refused(role, module, f"it takes '{name}', and there is none; give {GIVE[name]}")
        self.inputs = list(dict.fromkeys(one.name for each in observed for one in each.inputs))
        self.inputs += [name for name in self.roles if name != "state"]
        self.inputs += ["state"] if "state" in self.roles or self.kept else []
        has = {"action": True, "message": role == "encode" or contract.message, "state_next": self.own_state}
        self.own_outputs = [name for name in OUTPUTS[role] if has[name]]
        made = self.made_of(example(self.inputs, contract))
        self.outputs = [name for name in OUTPUTS[role] if name in made]
        for name in self.outputs:
            if made[name].dim() != 2 or made[name].shape[0] != EXAMPLE[0]:
                shape = list(made[name].shape)
                raise Refused(role, module, f"its '{name}' is {shape} for {EXAMPLE[0]} robots; [{EXAMPLE[0]}, floats] is expected")
        self.floats = {name: made[name].shape[1] for name in self.outputs}

    def forward(self, *given: Tensor) -> tuple[Tensor, ...]:
        made = self._made(dict(zip(self.inputs, given)))
        # Copies: two outputs that are one tensor would have one name.
        return tuple(made[name].clone() for name in self.outputs)

    def made_of(self, given: Sequence[Tensor]) -> dict[str, Tensor]:
        """Returns the outputs by name.

        Raises:
            Refused: The module cannot take these inputs.
        """
        try:
            with torch.no_grad():
                return self._made(dict(zip(self.inputs, given)))
        except Refused:
            raise
        except Exception as error:
            sizes = ", ".join(f"{name} {list(one.shape)}" for name, one in zip(self.inputs, given))
            raise Refused(self.role, self.module, f"it does not take {sizes}: {str(error).splitlines()[0][:300]}") from None

    def _made(self, by_name: dict[str, Tensor]) -> dict[str, Tensor]:
        state = by_name.get("state")
        arguments = {name: by_name[name] for name in self.roles if name != "state"}
        if "state" in self.roles and state is not None:
            arguments["state"] = state[:, : self.own_state] if self.kept else state
        moved, at = [], self.own_state
        for each in self.observed:
            value = _taken(each, by_name)
            if f"of_{each.parameter}" in self.norms:
                value = self.norms[f"of_{each.parameter}"](value)
            if self.kept and state is not None:
                value = value.flatten(1)
                width = value.shape[1]
                before = state[:, at : at + (self.stack.frames - 1) * width]
                at += (self.stack.frames - 1) * width
                if self.stack.copies:
                    before = before + (1.0 - state[:, -1:]) * value.repeat(1, self.stack.frames - 1)
                value = torch.cat([before, value], dim=1)
                moved.append(value[:, width:])
            arguments[each.parameter] = value
        made = _named(self.module(**arguments), self.role, self.module, self.own_outputs)
        if self.kept and state is not None:
            own = [made["state_next"]] if self.own_state else []
            flag = [torch.ones_like(state[:, :1])] if self.stack.copies else []
            made["state_next"] = torch.cat(own + moved + flag, dim=1)
        return made


def example(inputs: Sequence[str], contract: Contract) -> tuple[Tensor, ...]:
    """Returns made-up values for these inputs of a graph."""
    robots, places = EXAMPLE[0], contract.max_neighbours if contract.pad == "max" else EXAMPLE[1]
    shapes: dict[str, tuple[int, ...]] = {one.name: one.shape for one in contract.observation}
    shapes |= {"messages": (places, contract.message), "edges": (places, contract.edge_floats)}
    shapes |= {"own_message": (contract.message,), "state": (contract.state,), "id": (contract.id_floats,)}
    drawn = torch.Generator().manual_seed(1)
    make = lambda name: torch.ones(robots, places) if name == "heard" else torch.randn(robots, *shapes[name], generator=drawn) / 2
    return tuple(make(name) for name in inputs)


def axes(inputs: Sequence[str], contract: Contract) -> list[dict[int, str]]:
    """Returns the names of the axes of inputs whose size the caller chooses."""
    of_neighbours = ("messages", "edges", "heard") if contract.pad == "exact" else ()
    return [{0: "R", 1: "K"} if name in of_neighbours else {0: "R"} for name in inputs]


def _taken(each: Observed, by_name: dict[str, Tensor]) -> Tensor:
    """Returns what a parameter takes of the inputs."""
    rows = []
    for part in each.parts:
        row = by_name[part[0].name]
        for one in part[1:]:
            row = row + by_name[one.name]
        rows.append(row)
    return rows[0] if len(rows) == 1 else torch.cat([row.flatten(1) for row in rows], dim=1)


def _named(made: Any, role: str, module: nn.Module, names: Sequence[str]) -> dict[str, Tensor]:
    """Returns the outputs of a module by their names. ``encode`` may leave the state as it is."""
    expected = f"({', '.join(names)})"
    if not isinstance(made, dict):
        rows = list(made) if isinstance(made, (tuple, list)) else [made]
        wanted = list(names)
        if role == "encode" and len(rows) == 1:
            wanted = wanted[:1]
        if len(rows) != len(wanted):
            raise Refused(role, module, f"it returns {len(rows)} tensors; {expected} is expected, in this order")
        made = dict(zip(wanted, rows))
    for name in names:
        if name not in made and not (role == "encode" and name == "state_next"):
            raise Refused(role, module, f"it does not return '{name}' of {expected}")
    for name, row in made.items():
        if name not in names or not isinstance(row, Tensor):
            raise Refused(role, module, f"it returns '{name}', which is none of {expected}, or no tensor")
    return {name: made[name] for name in names if name in made}


class Affine(nn.Module):
    """``(x - less) * scale + more``, and within the limit if there is one."""

    less: Tensor
    scale: Tensor
    more: Tensor

    def __init__(self, less: Any, scale: Any, more: Any, limit: float | None = None):
        super().__init__()
        for name, value in (("less", less), ("scale", scale), ("more", more)):
            self.register_buffer(name, torch.as_tensor(value, dtype=torch.float32).clone())
        self.limit = limit

    def forward(self, x: Tensor) -> Tensor:
        y = (x.flatten(1) - self.less) * self.scale + self.more
        return (y if self.limit is None else y.clamp(-self.limit, self.limit)).reshape(x.shape)


def norm_of(argument: str, given: Any, floats: int) -> Affine:
    """Returns a normalisation by mean and standard deviation, with a limit of what comes out if there is one."""
    if not isinstance(given, (tuple, list)) or len(given) not in (2, 3):
        raise Refused(argument, None, "give (mean, standard deviation), or (mean, standard deviation, limit)")
    try:
        mean, deviation = (np.broadcast_to(np.asarray(one, np.float64).reshape(-1), (floats,)).copy() for one in given[:2])
        limit = None if len(given) == 2 or given[2] is None else float(given[2])
    except (TypeError, ValueError):
        raise Refused(argument, None, f"it does not have one number for each of {floats} floats") from None
    if not (np.isfinite(mean).all() and np.isfinite(deviation).all() and (deviation > 0).all()):
        raise Refused(argument, None, "its numbers are not finite, or a standard deviation is not above zero")
    return Affine(mean, 1.0 / deviation, np.zeros(floats), limit)
