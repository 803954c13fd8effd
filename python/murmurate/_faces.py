"""What the faces for other tools have in common."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ._module import VecEnv

#: Arguments of :class:`murmurate.VecEnv` that a face without messages does not take, and why.
NO_MESSAGES = dict.fromkeys(("message", "message_size"), "no messages arrive here; take VecEnv or murmurate.torchrl.Env")


def refuse(options: Mapping[str, Any], why: Mapping[str, str]) -> None:
    """Raises a ValueError for the first option that a face does not take, with the reason."""
    for name, reason in why.items():
        if name in options:
            raise ValueError(f"{name}: {reason}")


class Begun:
    """Random numbers of an environment of a face: drawn from the operating system if no seed is given.

    An environment without a seed takes a new one at its first reset, so that copies which were made before differ: a tool
    copies one environment for its workers. Once it was reset, a copy continues to the bit.
    """

    def __init__(self, core: VecEnv, seed: int | None):
        self.core, self.drawn = core, seed is None

    def reset(self, seed: int | None, mask: np.ndarray | None = None) -> None:
        """Starts new episodes in all environments, or in those that the mask selects."""
        first = self.drawn and (mask is None or bool(np.all(mask)))
        if seed is None and first:
            seed, mask = int.from_bytes(os.urandom(8), "little") >> 1, None
        self.core.reset(mask, seed=seed)
        if seed is not None:
            self.drawn = False


def action_of(argument: str, given: Any, shape: Sequence[int]) -> np.ndarray:
    """Returns actions of a tool as an array of single floats, if they are real numbers in this shape.

    Raises:
        ValueError: They are not, by the name of the argument.
    """
    try:
        array = np.asarray(given)
    except ValueError as error:
        raise ValueError(f"{argument}: {error}") from None
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{argument}: its type is {array.dtype} and not one of real numbers, such as float32")
    if array.shape != tuple(shape):
        raise ValueError(f"{argument}: its shape is {list(array.shape)} and not {list(shape)}")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, np.float32)
