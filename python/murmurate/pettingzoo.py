"""One team as a parallel environment of PettingZoo (``pip install pettingzoo gymnasium``); and messages with delay, loss and
contention for parallel environments of others, by a wrapper."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils import wrappers
from pettingzoo.utils.conversions import aec_to_parallel_wrapper
from pettingzoo.utils.wrappers import BaseParallelWrapper

from ._faces import NO_MESSAGES, Begun, Spoken, action_of, heard_speech, refuse, seen
from ._module import VecEnv
from ._scenario import Task

#: Arguments of :class:`murmurate.VecEnv` that are not for this face, and why.
NOT_HERE = NO_MESSAGES | {
    "num_envs": "an environment of PettingZoo is one team",
    "threads": "one team needs one thread",
    "autoreset": "an environment of PettingZoo waits for reset()",
}

#: Wrappers that leave observations as they are; parallel environments of MPE have some of them.
_UNSEEN = (
    aec_to_parallel_wrapper,
    wrappers.AssertOutOfBoundsWrapper,
    wrappers.CaptureStdoutWrapper,
    wrappers.ClipOutOfBoundsWrapper,
    wrappers.OrderEnforcingWrapper,
)


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


class messages(BaseParallelWrapper):
    """Lets the agents of a parallel environment say something to each other, over a :class:`murmurate.Channel`.

    An action is a dictionary: ``action`` is that of the environment, ``message`` (M) what the agent says. An observation is a
    dictionary, too: ``observation`` is that of the environment. By index in ``possible_agents``, ``messages`` (R, M), ``heard``
    (R) and ``age`` (R) are the newest message that the agent has of each other one, whether there is one, and the time since
    it was sent [s]. Agents that have left say nothing. The environment itself does not know of messages::

        env = messages(simple_spread_v3.parallel_env(), 4, loss=0.2, delay_s=0.05)

    Args:
        env: Parallel environment; its agents are among ``possible_agents``.
        floats: Number of floats M of a message.
        position: Function of the environment that returns the positions of the possible agents [m] (R, 2); needed with
            ``range_m`` or a radio with a range.
        bytes: Length of a datagram [bytes]; None is 4 for each float, and 40 for all else that a team says of itself.
        options: Arguments of the channel, without ``num_envs``, ``num_robots``, ``content`` and ``threads``.

    Raises:
        ValueError: An argument is wrong; the message names it.
    """

    def __init__(
        self,
        env: ParallelEnv,
        floats: int,
        *,
        position: Callable[[ParallelEnv], np.ndarray] | None = None,
        bytes: int | None = None,
        **options: Any,
    ) -> None:
        refuse(options, {"threads": "one team needs one thread"})
        super().__init__(env)
        r = len(env.possible_agents)
        self.spoken = Spoken((1, r, floats), position is not None, bytes, options)
        self._position = position
        box = lambda least, *shape: spaces.Box(least, np.inf, shape, np.float32)
        self._acted = {
            agent: spaces.Dict({"action": env.action_space(agent), "message": box(-np.inf, floats)})
            for agent in env.possible_agents
        }
        self._observed = {
            agent: spaces.Dict(
                {
                    "observation": env.observation_space(agent),
                    "messages": box(-np.inf, r, floats),
                    "heard": spaces.MultiBinary(r),
                    "age": box(0.0, r),
                }
            )
            for agent in env.possible_agents
        }

    def observation_space(self, agent: str) -> spaces.Dict:
        return self._observed[agent]

    def action_space(self, agent: str) -> spaces.Dict:
        return self._acted[agent]

    def reset(self, seed: int | None = None, options: dict | None = None):
        observations, infos = self.env.reset(seed=seed, options=options)
        self.spoken.channel.reset(seed=None if seed is None else int(seed))
        return self._with_messages(observations), infos

    def step(self, actions: dict[str, dict[str, np.ndarray]]):
        """Sends the messages and advances the environment.

        Raises:
            ValueError: An action has no message of M finite numbers; the message names the agent.
        """
        said, sends = np.zeros(self.spoken.size, np.float32), []
        for robot, agent in enumerate(self.env.possible_agents):
            sends.append(agent in self.env.agents and agent in actions)
            if sends[-1]:
                said[0, robot] = _message_of(agent, actions[agent], said.shape[2:])
        self.spoken.send(said, self._position and self._position(self.env), sends=np.array([sends]))
        observations, *rest = self.env.step({agent: action["action"] for agent, action in actions.items()})
        return self._with_messages(observations), *rest

    def _with_messages(self, observations: dict[str, Any]) -> dict[str, dict[str, Any]]:
        channel = self.spoken.channel
        heard = {
            agent: {
                "messages": channel.said[0, robot].copy(),
                "heard": channel.heard[0, robot].astype(np.int8),
                "age": channel.age[0, robot].copy(),
            }
            for robot, agent in enumerate(self.env.possible_agents)
        }
        return {agent: {"observation": observation, **heard[agent]} for agent, observation in observations.items()}


def _message_of(agent: str, action: Any, shape: tuple[int, ...]) -> np.ndarray:
    """The message in an action."""
    for key in ("action", "message"):
        if not isinstance(action, dict) or key not in action:
            raise ValueError(f"actions['{agent}']: '{key}' is missing; it is a dictionary of 'action' and 'message'")
    return action_of(f"actions['{agent}']['message']", action["message"], shape)


class spoken(BaseParallelWrapper):
    """Lets what agents of MPE say (``pip install mpe2``) travel over a :class:`murmurate.Channel`.

    Speech is the environment's own: agents that are not ``silent`` utter ``dim_c`` floats, their ``state.c``, which others
    observe. Each agent now observes what it has last heard of each other one, and zeros where that is nothing. Actions and
    spaces stay as they are; rewards know what was said::

        env = spoken(simple_reference_v3.parallel_env(), loss=0.2, delay_s=0.1)

    Args:
        env: Parallel environment with the ``world`` and the ``scenario`` of MPE. Further wrappers go around the channel.
        bytes: Length of a datagram [bytes]; None is 4 for each float, and 40 for all else that a team says of itself.
        options: Arguments of the channel, without ``num_envs``, ``num_robots``, ``content`` and ``threads``. ``period_s`` is a
            step of the world by default, 0.1 s in MPE.

    Raises:
        ValueError: An argument is wrong, the environment's agents say nothing, or a wrapper of it may change what they observe;
            the message names it.
    """

    def __init__(self, env: ParallelEnv, *, bytes: int | None = None, **options: Any) -> None:
        refuse(options, {"threads": "one team needs one thread"})
        super().__init__(env)
        world = getattr(env.unwrapped, "world", None)
        speaks = [not agent.silent for agent in getattr(world, "agents", [])]
        if not any(speaks) or not world.dim_c:
            raise ValueError("env: its agents say nothing; murmurate.pettingzoo.messages adds messages to any")
        inner = env
        while inner is not env.unwrapped:
            if type(inner) not in _UNSEEN:
                why = "agents would not observe what it makes of their observations; wrap what spoken() returns"
                raise ValueError(f"env: {type(inner).__name__} is beneath the channel: {why}")
            inner = inner.aec_env if isinstance(inner, aec_to_parallel_wrapper) else inner.env
        self._world, self._sends = world, np.array([speaks])
        self._speech = Spoken((1, len(speaks), world.dim_c), True, bytes, {"period_s": world.dt, **options})

    def reset(self, seed: int | None = None, options: dict | None = None):
        observations, infos = self.env.reset(seed=seed, options=options)
        self._speech.channel.reset(seed=None if seed is None else int(seed))
        return self._heard(observations), infos

    def step(self, actions: dict[str, Any]):
        """Sends what agents say from where they are, and advances the environment.

        Raises:
            ValueError: An action has another shape, or is not finite; the message names the agent, and nothing has changed.
        """
        for agent in (agent for agent in self.possible_agents if agent in actions):
            action = action_of(f"actions['{agent}']", actions[agent], self.action_space(agent).shape)
            if not np.isfinite(action).all():
                raise ValueError(f"actions['{agent}']: it is not finite")
        position = np.stack([agent.state.p_pos for agent in self._world.agents])
        observations, *rest = self.env.step(actions)
        said = np.zeros(self._speech.size, np.float32)
        for robot, agent in enumerate(self._world.agents):
            if not agent.silent:
                said[0, robot] = agent.state.c
        self._speech.send(said, position, sends=self._sends)
        return self._heard(observations), *rest

    def state(self) -> np.ndarray:
        """What all agents observe, one after the other, as in MPE itself."""
        return np.concatenate([self._seen(robot) for robot in range(self._speech.size[1])])

    def _seen(self, listener: int) -> np.ndarray:
        agents, heard = self._world.agents, self._speech.channel.said[0, listener]
        others = [(at, other) for at, other in enumerate(agents) if at != listener and not other.silent]
        with heard_speech((other.state, "c", heard[at].astype(np.float64)) for at, other in others):
            return self.env.unwrapped.scenario.observation(agents[listener], self._world).astype(np.float32)

    def _heard(self, observations: dict[str, Any]) -> dict[str, np.ndarray]:
        number = {agent.name: robot for robot, agent in enumerate(self._world.agents)}
        return {agent: self._seen(number[agent]) for agent in observations}
