"""Policies in Python: the base class, and what a step takes and gives."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True)
class Inputs:
    """Inputs of a call, as 32-bit floats with the robots as first axis.

    Attributes:
        observation: Observations [R, ...] by the names of the contract.
        heard: 1 for each place with a neighbour, 0 for an empty one [R, K]; None in ``encode``.
        messages: Messages of the neighbours [R, K, M], zeros in empty places; None if there are none.
        edges: Features of the edges [R, K, E], zeros in empty places; None if there are none.
        own_message: The robot's message [R, M]: of the step before in ``step``, of this step in ``act``.
        state: What the policy remembers [R, S], zeros at the start; None if it remembers nothing.
        id: The robot's place in the team, one-hot [R, N] or as a number [R, 1]; None without a table ``robots`` in the contract.
    """

    observation: Mapping[str, np.ndarray]
    heard: np.ndarray | None = None
    messages: np.ndarray | None = None
    edges: np.ndarray | None = None
    own_message: np.ndarray | None = None
    state: np.ndarray | None = None
    id: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Outputs:
    """Outputs of a call.

    Attributes:
        action: Action [R, A], as the contract says; not in ``encode``.
        message: Message [R, M]; not in ``act``.
        state: State for the next step [R, S]; None leaves it as it is.
    """

    action: Any = None
    message: Any = None
    state: Any = None


class Policy:
    """Base class of policies. Override ``step``, or ``encode`` and ``act``.

    What a policy remembers goes in and comes out as ``state``: it belongs to the robot's host, which puts it back to
    zeros at an episode, after a gap and a restart. A policy that keeps anything else in itself shares it among robots.
    """

    def __init__(self, contract: Mapping[str, Any]) -> None:
        """Makes the policy for a contract, the content of its file."""
        self.contract = contract

    def reset(self, seed: int, robot: int) -> None:
        """Called when a robot begins an episode, or begins anew after a gap.

        ``seed`` is for random numbers: it follows from the seed of the run, the robot and the number of its resets.
        """

    def step(self, inputs: Inputs) -> Outputs:
        """Computes a whole step: action, message and state. The message is heard in the next step."""
        raise NotImplementedError

    def encode(self, inputs: Inputs) -> Outputs:
        """Computes the message of this step, and the state."""
        raise NotImplementedError

    def act(self, inputs: Inputs) -> Outputs:
        """Computes the action from what was heard, and the state."""
        raise NotImplementedError


def is_two(policy: Any) -> bool:
    """Returns whether a policy has ``encode`` and ``act``, and no ``step`` of its own."""
    own = getattr(type(policy), "step", None)
    return own is None or own is Policy.step
