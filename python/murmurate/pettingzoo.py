"""One team as a parallel environment of PettingZoo (``pip install pettingzoo gymnasium``)."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from ._module import VecEnv


class parallel_env(ParallelEnv):
    """One team; the agents are its robots, ``robot_0`` and so on.

    Arguments are those of :class:`murmurate.VecEnv`, without ``num_envs``, ``threads``, ``autoreset`` and ``message``.
    """

    metadata = {"name": "murmurate_v0", "render_modes": []}
    render_mode = None

    def __init__(self, scenario: str = "passage", *, seed: int = 0, **options: Any) -> None:
        self._core = VecEnv(scenario, 1, autoreset="disabled", seed=seed, **options)
        self.possible_agents = [f"robot_{robot}" for robot in range(self._core.num_robots)]
        self.agents: list[str] = []

    @functools.lru_cache(maxsize=None)
    def observation_space(self, agent: str) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, self._core.obs.shape[2:], np.float32)

    @functools.lru_cache(maxsize=None)
    def action_space(self, agent: str) -> spaces.Box:
        return spaces.Box(-self._core.limit_m_s, self._core.limit_m_s, (2,), np.float32)

    def reset(self, seed: int | None = None, options: dict | None = None):
        self._core.reset(seed=seed)
        self.agents = list(self.possible_agents)
        return self._by_agent(self._core.obs[0].copy()), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, np.ndarray]):
        core = self._core
        core.step(np.array([[actions[agent] for agent in self.possible_agents]], np.float32))
        ended, over = bool(core.terminated[0]), bool(core.truncated[0])
        agents = self.possible_agents
        result = (
            self._by_agent(core.obs[0].copy()),
            self._by_agent(core.reward[0].tolist()),
            dict.fromkeys(agents, ended),
            dict.fromkeys(agents, over),
            {agent: {"arrived": bool(core.arrived[0, robot])} for robot, agent in enumerate(agents)},
        )
        if ended or over:
            self.agents = []
        return result

    def _by_agent(self, values):
        return dict(zip(self.possible_agents, values))
