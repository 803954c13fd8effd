"""Inputs for the probe of a policy file: a small team, what each of its robots observes, and the messages that it hears."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ._hops import Refused

if TYPE_CHECKING:
    from torch import Tensor

#: Number of floats of each feature of an edge: of the pair of a message's sender and receiver.
EDGE_WIDTHS = {"age": 1, "relative-position": 2, "distance": 1, "relative-velocity": 2}


class Team:
    """Robots of a probe: eight, of which one receives no message, one a single message and the others four; or as many as
    ``everybody`` says, who all hear each other.

    Attributes:
        observation: What each observes, by the fields of the environment (8, F).
        index: Senders and receivers of the messages (2, E), as PyTorch Geometric takes them.
        edge: Features of the messages' edges (E, D).
        inputs: Tensors of the probe, by name.
    """

    def __init__(self, fields: Sequence[str], edge: Sequence[str], everybody: int | None = None):
        import torch

        robots, rng = everybody or 8, np.random.default_rng(1)
        drawn = rng.uniform(-1.5, 1.5, (3, robots, 2)).round(3).astype(np.float32)
        position, velocity, goal = torch.from_numpy(drawn)
        known: dict[str, Tensor] = {
            "goal-minus-position": goal - position,
            "position": position,
            "velocity": velocity,
            "goal": goal,
            "position-plus-velocity": position + velocity,
        }
        missing = [field for field in fields if field not in known]
        if missing:
            raise Refused("like", None, f"its observation has '{missing[0]}', which cannot be exported")
        self.observation = torch.cat([known[field] for field in fields], dim=1)
        # Whole milliseconds, in which the program counts time here.
        age = torch.from_numpy(rng.integers(0, 200, (robots, robots)).astype(np.float32) / np.float32(1000.0))
        heard = 1 - np.eye(robots, dtype=np.float32)
        if everybody is None:
            heard[:] = 0
            heard[1, 2] = 1
            for robot in range(2, robots):
                heard[robot, rng.choice([other for other in range(robots) if other != robot], 4, replace=False)] = 1
        receiver, sender = torch.from_numpy(heard).nonzero(as_tuple=True)
        self.index = torch.stack([sender, receiver])
        way = position[sender] - position[receiver]
        features = {
            "age": age[receiver, sender, None],
            "relative-position": way,
            "distance": way.norm(dim=1, keepdim=True),
            "relative-velocity": velocity[sender] - velocity[receiver],
        }
        self.edge = torch.cat([features[name] for name in edge] or [way[:, :0]], dim=1)
        self.inputs = {
            "position": position,
            "velocity": velocity,
            "goal": goal,
            "age": age,
            "heard": torch.from_numpy(heard),
        }
