"""Many teams as a vector environment of Gymnasium (``pip install gymnasium``), for trainings with one flat policy a team.

Observations and actions of a team's robots are joined; the reward is the mean of theirs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv

from ._module import VecEnv


class TeamVectorEnv(VectorEnv):
    """N environments, each with the observations (R * F) and actions (R * 2) of a whole team.

    Arguments are those of :class:`murmurate.VecEnv`, without ``autoreset`` and ``message``. An episode that ends is
    followed by the next one in the same step; ``infos["final_obs"]`` has its last observations.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(self, scenario: str = "passage", num_envs: int = 1, *, seed: int = 0, **options: Any) -> None:
        core = self._core = VecEnv(scenario, num_envs, autoreset="same-step", seed=seed, **options)
        self.num_envs = num_envs
        floats = core.num_robots * core.obs.shape[2]
        limit = core.limit_m_s
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (floats,), np.float32)
        self.single_action_space = spaces.Box(-limit, limit, (2 * core.num_robots,), np.float32)
        self.observation_space = spaces.Box(-np.inf, np.inf, (num_envs, floats), np.float32)
        self.action_space = spaces.Box(-limit, limit, (num_envs, 2 * core.num_robots), np.float32)

    def reset(self, *, seed: int | list[int] | None = None, options: dict | None = None):
        if isinstance(seed, (list, tuple)):
            raise ValueError("seed: one number for all environments, each of which has its own random stream")
        mask = (options or {}).get("reset_mask")
        self._core.reset(mask, seed=seed)
        return self._flat(self._core.obs), {}

    def step(self, actions: np.ndarray):
        core = self._core
        core.step(np.ascontiguousarray(actions, np.float32).reshape(self.num_envs, core.num_robots, 2))
        infos: dict[str, Any] = {"arrived": core.arrived.copy(), "_arrived": np.ones(self.num_envs, bool)}
        ended = core.terminated | core.truncated
        if ended.any():
            infos["final_obs"] = self._flat(core.last_obs)
            infos["_final_obs"] = ended
        return (
            self._flat(core.obs),
            core.reward.mean(axis=1, dtype=np.float64),
            core.terminated.copy(),
            core.truncated.copy(),
            infos,
        )

    def _flat(self, values: np.ndarray) -> np.ndarray:
        return values.reshape(self.num_envs, -1).copy()
