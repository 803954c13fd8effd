"""What the faces for other tools have in common."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ._module import Channel, VecEnv

#: Arguments of :class:`murmurate.VecEnv` that a face without messages does not take, and why.
NO_MESSAGES = dict.fromkeys(("message", "message_size"), "no messages arrive here; take VecEnv or murmurate.torchrl.Env")


def seen(core: VecEnv, *, last: bool = False) -> np.ndarray:
    """Returns a copy of what each robot observes (N, R, F + K): its observation, the distances of its lidar, and what the
    method ``observe`` of a task in Python returns, if there are any.

    With ``last`` it is that before an automatic reset.
    """
    parts = (core.last_obs, core.last_scan, core.last_observed) if last else (core.obs, core.scan, core.observed)
    return np.concatenate([part for part in parts if part.shape[2]], axis=2)


def refuse(options: Mapping[str, Any], why: Mapping[str, str]) -> None:
    """Raises a ValueError for the first option that a face does not take, with the reason."""
    for name, reason in why.items():
        if name in options:
            raise ValueError(f"{name}: {reason}")


class Spoken:
    """Channel of a face for environments of others: what N teams of R robots say in M floats.

    Without a seed one is drawn, as everywhere in the faces.

    Args:
        size: Numbers N, R and M.
        placed: Whether ``send`` gets positions.
        length: Length of a datagram [bytes]; None is 4 for each float, and 40 for all else that a team says of itself.
        options: Further arguments of :class:`murmurate.Channel`.

    Raises:
        ValueError: An argument is wrong, or positions are needed and there are none; the message names it.
    """

    def __init__(
        self,
        size: tuple[int, int, int],
        placed: bool,
        length: int | None,
        options: Mapping[str, Any],
    ) -> None:
        taken = "it is that of the environment"
        refuse(options, {"num_envs": taken, "num_robots": taken, "content": "it is the argument 'floats'"})
        self.size = size
        self._length = 40 + 4 * size[2] if length is None else length
        self.channel = Channel(*size[:2], content=size[2], **{"seed": None, **options})
        if self.channel.needs_position and not placed:
            raise ValueError("position: it is missing; who hears whom depends on it")

    def send(self, said: np.ndarray, position: Any = None, *, sends: np.ndarray | None = None) -> None:
        """Sends messages (N, R, M) from the positions of all robots [m] (N, R, 2), and goes on by a period. It is to be called
        before the environment moves, so that a wrong message changes nothing there.

        Raises:
            ValueError: A message is not finite, or positions have another shape.
        """
        if position is not None:
            position = np.array(position, np.float32, order="C").reshape(*self.size[:2], 2)
        self.channel.step(position, sends=sends, bytes=self._length, content=said)


@contextlib.contextmanager
def heard_speech(heard: Iterable[tuple[Any, str, Any]]) -> Iterator[None]:
    """Lets states of agents have what a listener has heard of them, while the block computes what it observes.

    Each entry is a state, the name of its utterance, and what was heard.
    """
    kept = []
    try:
        for state, name, value in heard:
            kept.append((state, name, getattr(state, name)))
            setattr(state, name, value)
        yield
    finally:
        for state, name, value in kept:
            setattr(state, name, value)


class Begun:
    """Random numbers of an environment of a face: drawn from the operating system if no seed is given.

    An environment without a seed takes a new one at its first reset, so that copies which were made before differ: a tool
    copies one environment for its workers. Once it was reset, a copy continues to the bit.

    Tools also try an environment before they use it: RLlib resets it with the seed 42 and makes a step, in each of its
    runners, which would all go on with the same episodes. So an environment that has begun without a seed, and was then
    given one, goes back to numbers of its own if the first episode with that seed is abandoned.
    """

    def __init__(self, core: VecEnv, seed: int | None):
        self.core, self.drawn = core, seed is None
        #: Seed that was drawn, as long as nothing else was asked for; whether the current episode may be a trial.
        self.own: int | None = None
        self.tried = False

    def reset(self, seed: int | None, mask: np.ndarray | None = None, *, abandoned: bool = False) -> None:
        """Starts new episodes in all environments, or in those that the mask selects.

        ``abandoned`` says whether the episode at hand was begun, with at least a step, and is not over.
        """
        if seed is not None:
            self.core.reset(mask, seed=seed)
            self.drawn, self.tried = False, self.own is not None
        elif self.drawn and (mask is None or bool(np.all(mask))):
            self._go_on_with(int.from_bytes(os.urandom(8), "little") >> 1)
        elif self.tried and abandoned and self.own is not None:
            self._go_on_with((self.own + 1) % 2**63)
        else:
            self.core.reset(mask)
            # Whatever seed was given is now used in earnest.
            self.own, self.tried = (None if self.tried else self.own), False

    def _go_on_with(self, own: int) -> None:
        self.core.reset(seed=own)
        self.drawn, self.own, self.tried = False, own, False


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
