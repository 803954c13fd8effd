"""Messages over a channel beside the observations and actions of an environment of Gymnasium (``murmurate.gymnasium``)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from ._faces import action_of, refuse
from ._module import Channel


class Spoken:
    """Channel of N teams of R robots, with the spaces of what they say and hear.

    Args:
        size: Numbers N, R and M of teams, robots and floats of a message.
        position: Function that returns the positions of all robots [m] (N, R, 2) before a step; None without.
        length: Length of a datagram [bytes]; None is 4 for each float, and 40 for all else that a team says of itself.
        options: Further arguments of :class:`murmurate.Channel`.
    """

    def __init__(
        self,
        size: tuple[int, int, int],
        position: Callable[[], np.ndarray] | None,
        length: int | None,
        options: dict[str, Any],
    ) -> None:
        taken = "it is that of the environment"
        refuse(options, {"num_envs": taken, "num_robots": taken, "content": "it is the argument 'floats'"})
        self.size, self._position = size, position
        self._length = 40 + 4 * size[2] if length is None else length
        self.channel = Channel(*size[:2], content=size[2], **options)

    def actions(self, own: spaces.Space, *, one: bool) -> spaces.Dict:
        """Space of actions with messages, of ``one`` team or of all."""
        shape = self.size[1:] if one else self.size
        return spaces.Dict({"action": own, "message": spaces.Box(-np.inf, np.inf, shape, np.float32)})

    def observations(self, own: spaces.Space, *, one: bool) -> spaces.Dict:
        """Space of observations with what was heard, of ``one`` team or of all."""
        n, r, m = self.size
        shape = (r, r) if one else (n, r, r)
        heard = {
            "messages": spaces.Box(-np.inf, np.inf, (*shape, m), np.float32),
            "heard": spaces.MultiBinary(shape),
            "age": spaces.Box(0.0, np.inf, shape, np.float32),
        }
        return spaces.Dict({"observation": own, **heard})

    def placed(self) -> np.ndarray | None:
        """Positions at which robots speak, before the environment moves."""
        if self._position is None:
            return None
        return np.array(self._position(), np.float32, order="C").reshape(*self.size[:2], 2)

    def said(self, actions: Any, *, one: bool) -> tuple[Any, np.ndarray]:
        """Actions of the environment, and messages (N, R, M).

        Raises:
            ValueError: An entry is missing, or a message is no M real numbers of each robot.
        """
        for key in ("action", "message"):
            if not isinstance(actions, Mapping) or key not in actions:
                raise ValueError(f"actions: '{key}' is missing; they are a dictionary of 'action' and 'message'")
        shape = self.size[1:] if one else self.size
        return actions["action"], action_of("actions['message']", actions["message"], shape).reshape(self.size)

    def send(self, placed: np.ndarray | None, said: np.ndarray) -> None:
        """Sends the messages, and goes on by a period."""
        self.channel.step(placed, bytes=self._length, content=said)

    def seen(self, observation: Any, *, one: bool) -> dict[str, Any]:
        """Observation with what was heard."""
        pick = (lambda array: array[0].copy()) if one else (lambda array: array.copy())
        channel = self.channel
        heard = {"messages": pick(channel.said), "heard": pick(channel.heard).astype(np.int8), "age": pick(channel.age)}
        return {"observation": observation, **heard}
