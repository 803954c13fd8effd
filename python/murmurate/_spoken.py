"""Messages beside the observations and actions of environments of Gymnasium (``murmurate.gymnasium``): spaces and entries."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from ._faces import Spoken, action_of


class TeamSpoken(Spoken):
    """Channel of N teams, with the spaces of what they say and hear. ``one`` is for a single team, without the axis N."""

    def actions(self, own: spaces.Space, *, one: bool) -> spaces.Dict:
        """Space of actions with messages."""
        shape = self.size[1:] if one else self.size
        return spaces.Dict({"action": own, "message": spaces.Box(-np.inf, np.inf, shape, np.float32)})

    def observations(self, own: spaces.Space, *, one: bool) -> spaces.Dict:
        """Space of observations with what was heard."""
        n, r, m = self.size
        shape = (r, r) if one else (n, r, r)
        heard = {
            "messages": spaces.Box(-np.inf, np.inf, (*shape, m), np.float32),
            "heard": spaces.MultiBinary(shape),
            "age": spaces.Box(0.0, np.inf, shape, np.float32),
        }
        return spaces.Dict({"observation": own, **heard})

    def speak(self, actions: Any, position: Any, *, one: bool) -> Any:
        """Sends the messages among the actions from these positions, and returns the actions of the environment.

        Raises:
            ValueError: An entry is missing, or a message is no M finite numbers of each robot.
        """
        for key in ("action", "message"):
            if not isinstance(actions, Mapping) or key not in actions:
                raise ValueError(f"actions: '{key}' is missing; they are a dictionary of 'action' and 'message'")
        shape = self.size[1:] if one else self.size
        self.send(action_of("actions['message']", actions["message"], shape).reshape(self.size), position)
        return actions["action"]

    def seen(self, observation: Any, *, one: bool) -> dict[str, Any]:
        """Observation with what was heard."""
        pick = (lambda array: array[0].copy()) if one else (lambda array: array.copy())
        channel = self.channel
        heard = {"messages": pick(channel.said), "heard": pick(channel.heard).astype(np.int8), "age": pick(channel.age)}
        return {"observation": observation, **heard}
