"""Comparison of exported graphs with the modules that they were made of, step by step with state and messages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ._contract import Contract, Input
from ._engine import Sample
from ._hops import Refused
from ._onnx import Session

#: Largest difference between outputs of a module and of its graph, relative for outputs above 1.
TOLERANCE = 1e-5
#: Number of steps of the comparison that is part of an export.
STEPS = 64
#: Number of robots in a call.
ROBOTS = 4
#: What to do about outputs that are not finite without a neighbour.
MEND = (
    "give empty places no weight without dividing by zero: weight = score.clamp(-30, 30).exp() * heard, and then "
    "weight / (weight.sum(-1, keepdim=True) + 1e-6); not -inf, and not the mask of nn.MultiheadAttention"
)


class Made:
    """Inputs that are made up, step by step: observations, neighbours, and messages that the robots have sent."""

    def __init__(self, contract: Contract, observation: Sequence[Input], seed: int = 1):
        self.contract, self.observation, self.rng = contract, list(observation), np.random.default_rng(seed)
        self.said = np.zeros((ROBOTS, contract.message), np.float32)

    def normal(self, *shape: int) -> np.ndarray:
        """Returns numbers of a normal distribution with a standard deviation of 0.5."""
        return (0.5 * self.rng.standard_normal(shape)).astype(np.float32)

    def step(self, heard: int | None, places: int) -> dict[str, np.ndarray]:
        """Returns all inputs of a step but the state. Each robot hears as many neighbours as said, or any number of them."""
        contract, rng = self.contract, self.rng
        counts = rng.integers(0, places + 1, ROBOTS) if heard is None else np.full(ROBOTS, heard)
        mask = (np.arange(places) < counts[:, None]).astype(np.float32)
        senders = rng.integers(0, ROBOTS, (ROBOTS, places))
        made = {one.name: self.normal(ROBOTS, *one.shape) for one in self.observation}
        made |= {"heard": mask, "own_message": self.said, "messages": self.said[senders] * mask[:, :, None]}
        if contract.robots is not None:
            number = np.arange(ROBOTS)[:, None] % contract.robots.get("most", ROBOTS)
            one_hot = contract.robots["id"] == "one-hot"
            made["id"] = (number == np.arange(contract.id_floats) if one_hot else number).astype(np.float32)
        return made | {"edges": self.normal(ROBOTS, places, contract.edge_floats) * mask[:, :, None]}


def compare(
    modules: dict[str, Any], graphs: dict[str, bytes], contract: Contract, steps: int = STEPS
) -> tuple[dict[str, float], list[Sample]]:
    """Runs modules and graphs on the same inputs, each with its own state.

    Returns the largest difference of each output by its name, and some of the steps: with no neighbour, with one place, and with
    the most places.

    Args:
        modules: Modules by their roles, in the order of a step; their attributes ``inputs`` and ``outputs`` name tensors.
        graphs: The graph of each.
        contract: Contract of both.
        steps: Least number of steps; the number of neighbours changes with each.

    Raises:
        Refused: An output differs by more than 1e-5, or is not finite.
    """
    steps = max(steps, 2 * (contract.max_neighbours + 1))
    sessions = {role: Session(data) for role, data in graphs.items()}
    inputs_of_modules = {one.name: one for module in modules.values() for each in module.observed for one in each.inputs}
    made = Made(contract, list(inputs_of_modules.values()))
    worst: dict[str, float] = {}
    samples: list[Sample] = []
    states = [np.zeros((ROBOTS, contract.state), np.float32) for _ in range(2)]
    for step in range(steps):
        most = contract.max_neighbours
        # None, 1, 2, ... up to the most, and then again with numbers that differ from robot to robot.
        turn, some = step % (most + 1), (step // (most + 1)) % 2
        places = most if contract.pad == "max" else max(1, turn)
        inputs = made.step(None if some and turn else turn, places)
        said = "with no neighbour heard" if turn == 0 else f"with {places} places for neighbours in step {step}"
        for role, module in modules.items():
            given = [inputs | {"state": state} for state in states]
            rows = [_asked(module, given[0]), _answered(sessions[role], given[1], role, said)]
            for name, of_torch in rows[0].items():
                place = f"{said} its output '{name}'"
                if not np.isfinite(of_torch).all():
                    raise Refused(role, module.module, f"{place} is not finite{'; ' + MEND if turn == 0 else ''}")
                off = _difference(of_torch, rows[1][name])
                if not off <= TOLERANCE:
                    mend = f"; {MEND}" if turn == 0 and not np.isfinite(off) else ""
                    why = f"{place} differs by {off:.1e} between PyTorch and the graph, over {TOLERANCE:.0e}{mend}"
                    raise Refused(role, module.module, why)
                worst[name] = max(off, worst.get(name, 0.0))
            if contract.max_neighbours < step <= 2 * contract.max_neighbours + 1 and turn in (0, 1, most):
                samples.append(Sample(role, said, given[0], rows[0]))
            states = [row.get("state_next", state) for row, state in zip(rows, states)]
            if "message" in rows[0]:
                if role == "encode":
                    # Heard in the same step.
                    senders = made.rng.integers(0, ROBOTS, inputs["heard"].shape)
                    inputs["messages"] = rows[0]["message"][senders] * inputs["heard"][:, :, None]
                    inputs["own_message"] = rows[0]["message"]
                made.said = rows[0]["message"]
    return worst, samples


def _asked(module: Any, inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns the outputs of a module by name."""
    import torch

    with torch.no_grad():
        rows = module(*(torch.from_numpy(np.ascontiguousarray(inputs[name])) for name in module.inputs))
    return {name: row.numpy() for name, row in zip(module.outputs, rows)}


def _answered(session: Session, inputs: dict[str, np.ndarray], role: str, said: str) -> dict[str, np.ndarray]:
    try:
        return session.run(inputs)
    except Exception as error:
        raise Refused(role, None, f"{said} its graph does not run: {str(error).splitlines()[0][:300]}") from None


def _difference(one: np.ndarray, other: np.ndarray) -> float:
    """Returns the largest difference, relative for numbers above 1; not finite if a number is not."""
    if one.shape != other.shape:
        return float("inf")
    return float((np.abs(one - other) / np.maximum(np.abs(one), 1.0)).max(initial=0.0))
