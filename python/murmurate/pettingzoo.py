"""One team as a parallel environment of PettingZoo (``pip install pettingzoo gymnasium``)."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from ._faces import NO_MESSAGES, Begun, action_of, refuse, seen
from ._module import VecEnv
from ._scenario import Task

#: Arguments of :class:`murmurate.VecEnv` that are not for this face, and why.
NOT_HERE = NO_MESSAGES | {
    "num_envs": "an environment of PettingZoo is one team",
    "threads": "one team needs one thread",
    "autoreset": "an environment of PettingZoo waits for reset()",
}


class parallel_env(ParallelEnv):
    """One team; the agents are its robots, ``robot_0`` and so on. With a lidar (``senses``) its distances follow the observation.

    Arguments are those of :class:`murmurate.VecEnv`, without ``num_envs``, ``threads``, ``autoreset`` and ``message``. With
    ``seed=None``, the default, the seed is drawn. ``core`` is the :class:`murmurate.VecEnv` within.

    Raises:
        ValueError: An argument is wrong, or not for this face; the message names it.
    """

    metadata = {"name": "murmurate_v0", "render_modes": ["rgb_array"], "render_fps": 20, "is_parallelizable": True}

    def __init__(
        self,
        scenario: Task = "passage",
        *,
        seed: int | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        refuse(options, NOT_HERE)
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode: '{render_mode}' is neither None nor 'rgb_array'")
        self.render_mode = render_mode
        self.core = VecEnv(scenario, 1, autoreset="disabled", seed=seed, **options)
        self._begun = Begun(self.core, seed)
        self.possible_agents = [f"robot_{robot}" for robot in range(self.core.num_robots)]
        self.agents: list[str] = []
        limit = self.core.limit_m_s
        # One space an agent, as each has a random stream of its own.
        self.observation_spaces = {
            agent: spaces.Box(-np.inf, np.inf, seen(self.core).shape[2:], np.float32) for agent in self.possible_agents
        }
        self.action_spaces = {agent: spaces.Box(-limit, limit, (2,), np.float32) for agent in self.possible_agents}
        self._was_reset, self._steps = False, 0

    def observation_space(self, agent: str) -> spaces.Box:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Box:
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict | None = None):
        self._begun.reset(seed, abandoned=self._steps > 0 and bool(self.agents))
        self._was_reset, self._steps = True, 0
        self.agents = list(self.possible_agents)
        return self._by_agent(seen(self.core)[0]), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, np.ndarray]):
        """Advances the team. After the end of an episode, and without actions, it returns five empty dictionaries.

        Raises:
            ValueError: An action is missing, of an unknown agent, or no two real numbers; the message names the agent.
            RuntimeError: There are actions, but no episode: ``reset()`` comes first.
        """
        if not self.agents:
            if self._was_reset and not actions:
                return {}, {}, {}, {}, {}
            ended = "the episode is over" if self._was_reset else "no episode has begun"
            raise RuntimeError(f"step: {ended}; call reset() first")
        core, agents = self.core, self.possible_agents
        core.step(self._joined(actions))
        self._steps += 1
        ended, over = bool(core.terminated[0]), bool(core.truncated[0])
        result = (
            self._by_agent(seen(core)[0]),
            self._by_agent(core.reward[0].tolist()),
            dict.fromkeys(agents, ended),
            dict.fromkeys(agents, over),
            {agent: {"arrived": bool(core.arrived[0, robot])} for robot, agent in enumerate(agents)},
        )
        if ended or over:
            self.agents = []
        return result

    def render(self) -> np.ndarray | None:
        """Picture of the team (height, width, 3), with ``render_mode="rgb_array"``."""
        return self.core.render() if self.render_mode else None

    def close(self) -> None:
        """Does nothing: an environment holds memory alone."""

    def _joined(self, actions: dict[str, np.ndarray]) -> np.ndarray:
        """Checks the actions of all agents and returns them as (1, R, 2)."""
        if not isinstance(actions, dict):
            raise ValueError(f"actions: a {type(actions).__name__} is no dictionary by agent")
        unknown = [agent for agent in actions if agent not in self.observation_spaces]
        if unknown:
            raise ValueError(f"actions: '{unknown[0]}' is none of the agents {', '.join(self.possible_agents)}")
        missing = [agent for agent in self.possible_agents if agent not in actions]
        if missing:
            raise ValueError(f"actions: that of '{missing[0]}' is missing")
        return np.stack([action_of(f"actions['{agent}']", actions[agent], (2,)) for agent in self.possible_agents])[None]

    def _by_agent(self, values):
        return dict(zip(self.possible_agents, values))
