"""Teams as environments of Gymnasium (``pip install gymnasium``), for trainings with one flat policy a team.

Observations and actions of a team's robots are joined; the reward is the mean of theirs. With a lidar (``senses``) its distances
follow each robot's observation, and so does what a task in Python observes. Once this module is imported,
``gymnasium.make`` and ``gymnasium.make_vec`` know ``murmurate/Passage-v0``, ``murmurate/Swap-v0`` and
``murmurate/Flocking-v0``; ``gymnasium.make("murmurate.gymnasium:murmurate/Passage-v0")`` imports it.

:class:`Messages` and :class:`VectorMessages` let the robots of an environment say something to each other, with delay, loss and
contention.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from ._faces import NO_MESSAGES, Begun, action_of, refuse, seen
from ._module import VecEnv
from ._scenario import Task
from ._spoken import TeamSpoken

#: Treatment of an ended episode, as Gymnasium names it.
MODES = {
    "same-step": AutoresetMode.SAME_STEP,
    "next-step": AutoresetMode.NEXT_STEP,
    "disabled": AutoresetMode.DISABLED,
}


#: Names of single environments by scenario.
NAMES = {"passage": "murmurate/Passage-v0", "swap": "murmurate/Swap-v0", "flocking": "murmurate/Flocking-v0"}


def _spaces(core: VecEnv, first: tuple[int, ...] = ()) -> tuple[spaces.Box, spaces.Box]:
    """Spaces of a whole team's observations and actions."""
    robots, limit = core.num_robots, core.limit_m_s
    floats = core.obs.shape[2] + core.scan.shape[2] + core.observed.shape[2]
    observed = spaces.Box(-np.inf, np.inf, (*first, robots * floats), np.float32)
    return observed, spaces.Box(-limit, limit, (*first, 2 * robots), np.float32)


class TeamVectorEnv(VectorEnv):
    """N environments, each with the observations (R * F) and actions (R * 2) of a whole team.

    Arguments are those of :class:`murmurate.VecEnv`, without ``message``. With ``seed=None``, the default, the seed is drawn.
    ``core`` is the :class:`murmurate.VecEnv` within.

    Args:
        autoreset: "same-step": an episode that ends is followed by the next one in the same step; ``infos["final_obs"]`` has
            its last observations, ``infos["final_info"]`` its last information. "next-step": the next one begins in the next
            step, whose action is ignored and whose reward is 0. "disabled": in ``reset(options={"reset_mask": mask})``.
            Wrappers that transform observations take the last two.

    Raises:
        ValueError: An argument is wrong, or not for this face; the message names it.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20, "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self,
        scenario: Task = "passage",
        num_envs: int = 1,
        *,
        seed: int | None = None,
        autoreset: str = "same-step",
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        refuse(options, NO_MESSAGES)
        if autoreset not in MODES:
            raise ValueError(f"autoreset: '{autoreset}' is none of {', '.join(MODES)}")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode: '{render_mode}' is neither None nor 'rgb_array'")
        self.metadata = {**self.metadata, "autoreset_mode": MODES[autoreset]}
        self.render_mode, self._mode = render_mode, MODES[autoreset]
        within = "same-step" if autoreset == "same-step" else "disabled"
        core = self.core = VecEnv(scenario, num_envs, autoreset=within, seed=seed, **options)
        self._begun = Begun(core, seed)
        self.num_envs = core.num_envs
        self._ended = np.zeros(self.num_envs, bool)
        self.single_observation_space, self.single_action_space = _spaces(core)
        self.observation_space, self.action_space = _spaces(core, (self.num_envs,))

    def reset(self, *, seed: int | list[int] | None = None, options: dict | None = None):
        """Starts new episodes, in all environments or in those of ``options["reset_mask"]``.

        Raises:
            ValueError: The seed is no single number, or given with a mask.
        """
        if isinstance(seed, (list, tuple, np.ndarray)):
            raise ValueError("seed: one number for all environments, each of which has its own random stream")
        mask = (options or {}).get("reset_mask")
        self._begun.reset(seed, mask)
        self._ended &= False if mask is None else ~mask
        return self._flat(seen(self.core)), {}

    def step(self, actions: np.ndarray):
        """Advances all environments.

        Raises:
            ValueError: The actions are no real numbers (N, R * 2).
            RuntimeError: An episode is over and waits for ``reset``.
        """
        core, before = self.core, self._ended
        flat = action_of("actions", actions, self.action_space.shape)
        if self._mode is AutoresetMode.DISABLED and before.any():
            which = np.flatnonzero(before)[:5].tolist()
            raise RuntimeError(f"step: episodes are over (environments {which}); call reset(options={{'reset_mask': ...}}) first")
        core.step(flat.reshape(self.num_envs, core.num_robots, 2))
        if self._mode is AutoresetMode.NEXT_STEP and before.any():
            core.reset(before)
        terminated, truncated = core.terminated.copy(), core.truncated.copy()
        self._ended = terminated | truncated
        infos: dict[str, Any] = {"arrived": core.arrived.copy(), "_arrived": np.ones(self.num_envs, bool)}
        if self._mode is AutoresetMode.SAME_STEP:
            if self._ended.any():
                infos["final_obs"], infos["_final_obs"] = self._flat(seen(core, last=True)), self._ended
                infos["final_info"] = {"arrived": core.arrived.copy(), "_arrived": self._ended}
                infos["_final_info"] = self._ended
            self._ended = np.zeros(self.num_envs, bool)
        return self._flat(seen(core)), core.reward.mean(axis=1, dtype=np.float64), terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Pictures of all environments, each (height, width, 3), with ``render_mode="rgb_array"``."""
        return tuple(map(self.core.render, range(self.num_envs))) if self.render_mode else None

    def _flat(self, values: np.ndarray) -> np.ndarray:
        return values.reshape(self.num_envs, -1)


class TeamEnv(gymnasium.Env):
    """One team, with the observations (R * F) and actions (R * 2) of all its robots.

    Arguments are those of :class:`murmurate.VecEnv`, without ``num_envs``, ``threads``, ``autoreset`` and ``message``. With
    ``seed=None``, the default, the seed is drawn. ``core`` is the :class:`murmurate.VecEnv` within.

    Raises:
        ValueError: An argument is wrong, or not for this face; the message names it.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(
        self,
        scenario: Task = "passage",
        *,
        seed: int | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        one = dict.fromkeys(("num_envs", "threads"), "it is one team; take TeamVectorEnv, or gymnasium.make_vec")
        refuse(options, NO_MESSAGES | one | {"autoreset": "a single environment waits for reset()"})
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode: '{render_mode}' is neither None nor 'rgb_array'")
        self.render_mode = render_mode
        self.core = VecEnv(scenario, 1, autoreset="disabled", seed=seed, **options)
        self._begun, self._over = Begun(self.core, seed), True
        self.observation_space, self.action_space = _spaces(self.core)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        super().reset(seed=seed)
        self._begun.reset(seed)
        self._over = False
        return seen(self.core).reshape(-1), {}

    def step(self, action: np.ndarray):
        """Advances the team.

        Raises:
            ValueError: The action is no real numbers (R * 2).
            RuntimeError: No episode has begun, or it is over: ``reset()`` comes first.
        """
        core = self.core
        flat = action_of("action", action, self.action_space.shape)
        if self._over:
            raise RuntimeError("step: no episode has begun, or it is over; call reset() first")
        core.step(flat.reshape(1, core.num_robots, 2))
        terminated, truncated = bool(core.terminated[0]), bool(core.truncated[0])
        self._over = terminated or truncated
        infos = {"arrived": core.arrived[0].copy()}
        return seen(core).reshape(-1), float(core.reward.mean(dtype=np.float64)), terminated, truncated, infos

    def render(self) -> np.ndarray | None:
        """Picture of the team (height, width, 3), with ``render_mode="rgb_array"``."""
        return self.core.render() if self.render_mode else None


class Messages(gymnasium.Wrapper):
    """Lets the R robots of one team say something to each other, over a :class:`murmurate.Channel`.

    An action is a dictionary of ``action``, that of the environment, and ``message`` (R, M). An observation has ``observation``,
    and by receiver and then by sender ``messages`` (R, R, M), ``heard`` and ``age`` (R, R): the newest message that a robot has of
    another one, whether there is one, and the time since it was sent [s]. The environment itself does not know of messages.

    Args:
        env: Environment of one team.
        num_robots: Number of robots R.
        floats: Number of floats M of a message.
        position: Function of the environment that returns the positions of the robots [m] (R, 2); needed with ``range_m`` or a
            radio with a range.
        bytes: Length of a datagram [bytes]; None is 4 for each float, and 40 for all else that a team says of itself.
        options: Further arguments of the channel.

    Raises:
        ValueError: An argument is wrong; the message names it.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        num_robots: int,
        floats: int,
        *,
        position: Callable[[gymnasium.Env], np.ndarray] | None = None,
        bytes: int | None = None,
        **options: Any,
    ) -> None:
        super().__init__(env)
        self.spoken = TeamSpoken((1, num_robots, floats), position is not None, bytes, options)
        self._position = position
        self.action_space = self.spoken.actions(env.action_space, one=True)
        self.observation_space = self.spoken.observations(env.observation_space, one=True)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        observation, info = self.env.reset(seed=seed, options=options)
        self.spoken.channel.reset(seed=None if seed is None else int(seed))
        return self.spoken.seen(observation, one=True), info

    def step(self, action: dict[str, Any]):
        """Sends the messages and advances the team.

        Raises:
            ValueError: An entry of the action is missing or wrong; the message names it.
        """
        observation, *rest = self.env.step(self.spoken.speak(action, self._position and self._position(self.env), one=True))
        return self.spoken.seen(observation, one=True), *rest


class VectorMessages(VectorWrapper):
    """:class:`Messages` for N teams at once, in any mode of automatic resets. Its arguments are those of that class.

    With resets in the same step, ``infos["final_obs"]`` has the last observations with what was heard.
    """

    def __init__(
        self,
        env: VectorEnv,
        num_robots: int,
        floats: int,
        *,
        position: Callable[[VectorEnv], np.ndarray] | None = None,
        bytes: int | None = None,
        **options: Any,
    ) -> None:
        super().__init__(env)
        spoken = TeamSpoken((env.num_envs, num_robots, floats), position is not None, bytes, options)
        self._position = position
        self.spoken, self._mode = spoken, env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP)
        self._ended = np.zeros(env.num_envs, bool)
        self.single_action_space = spoken.actions(env.single_action_space, one=True)
        self.action_space = spoken.actions(env.action_space, one=False)
        self.single_observation_space = spoken.observations(env.single_observation_space, one=True)
        self.observation_space = spoken.observations(env.observation_space, one=False)

    def reset(self, *, seed: int | list[int] | None = None, options: dict | None = None):
        observation, infos = self.env.reset(seed=seed, options=options)
        mask = (options or {}).get("reset_mask")
        if mask is None and isinstance(seed, (int, np.integer)):
            self.spoken.channel.reset(seed=int(seed))
        else:
            self.spoken.channel.reset(mask)
        self._ended &= False if mask is None else ~mask
        return self.spoken.seen(observation, one=False), infos

    def step(self, actions: dict[str, Any]):
        """Sends the messages and advances all teams.

        Raises:
            ValueError: An entry of the actions is missing or wrong; the message names it.
        """
        spoken = self.spoken
        own = spoken.speak(actions, self._position and self._position(self.env), one=False)
        observation, reward, terminated, truncated, infos = self.env.step(own)
        ended = terminated | truncated
        begins = ended if self._mode is AutoresetMode.SAME_STEP else self._ended & (self._mode is AutoresetMode.NEXT_STEP)
        if begins.any():
            if "final_obs" in infos:
                infos = {**infos, "final_obs": spoken.seen(infos["final_obs"], one=False)}
            spoken.channel.reset(np.ascontiguousarray(begins))
        self._ended = ended
        return spoken.seen(observation, one=False), reward, terminated, truncated, infos


for _scenario, _name in NAMES.items():
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name,
            entry_point="murmurate.gymnasium:TeamEnv",
            vector_entry_point="murmurate.gymnasium:TeamVectorEnv",
            kwargs={"scenario": _scenario},
        )
