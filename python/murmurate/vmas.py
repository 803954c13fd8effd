"""Scenarios of VMAS whose agents speak (``pip install vmas``), with delay, loss and contention between them."""

from __future__ import annotations

import functools
import random
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from vmas.scenarios import load
from vmas.simulator.core import Agent, World
from vmas.simulator.scenario import BaseScenario

from ._faces import Spoken, heard_speech, refuse


def spoken(
    scenario: str | type[BaseScenario], *, bytes: int | None = None, **options: Any
) -> BaseScenario:
    """Returns a scenario of VMAS in which what agents say travels over a :class:`murmurate.Channel`.

    Speech is the environment's own: agents that are not ``silent`` utter ``dim_c`` floats, their ``state.c``, which others
    observe. Each agent now observes what it has last heard of each other one, and zeros where that is nothing. Rewards, ends
    and the pictures know what was said. Gradients pass through what was heard (``grad_enabled`` of VMAS). All takes it that
    takes a scenario::

        env = VmasEnv(spoken("simple_reference", radio="wifi", loss=0.2), num_envs=64)

    Args:
        scenario: Name of a scenario of VMAS, or a class.
        bytes: Length of a datagram [bytes]; None is 4 for each float, and 40 for all else that a team says of itself.
        options: Arguments of the channel, without ``num_envs``, ``num_robots`` and ``content``. ``period_s`` is a step of the
            world by default, 0.1 s in VMAS. Without ``seed`` its numbers follow those of the environment.

    Raises:
        ValueError: An argument is wrong; the message names it. When the environment is made, also if its agents say nothing.
    """
    refuse(options, dict.fromkeys(("num_envs", "num_robots", "content"), "it is that of the environment"))
    if not isinstance(scenario, str) and not (isinstance(scenario, type) and issubclass(scenario, BaseScenario)):
        raise ValueError(f"scenario: {scenario!r} is neither a name nor a class of a scenario of VMAS")
    made = _class_of(scenario)()
    made._of, made._bytes, made._options = scenario, bytes, options
    return made


@functools.cache
def _class_of(scenario: str | type[BaseScenario]) -> type[BaseScenario]:
    kind = scenario
    if isinstance(scenario, str):
        kind = load(scenario if scenario.endswith(".py") else f"{scenario}.py").Scenario
    return type(f"Spoken{kind.__name__}", (_Spoken, kind), {"__doc__": kind.__doc__})


class _Spoken(BaseScenario):
    """What a scenario has in addition; it comes before the scenario's own class."""

    _spoken: Spoken | None = None

    def __reduce__(self):
        # The class is made here, so that it has no name by which it could be found again.
        state = {name: value for name, value in self.__dict__.items() if name not in ("_of", "_bytes", "_options")}
        return _restored, (self._of, self._bytes, self._options), state

    def make_world(self, batch_dim: int, device: torch.device, **kwargs: Any) -> World:
        world = super().make_world(batch_dim, device, **kwargs)
        speaks = [not agent.silent for agent in world.agents]
        if world.dim_c == 0 or not any(speaks):
            raise ValueError("scenario: its agents say nothing; murmurate.torchrl.Messages adds messages to any")
        options = {"period_s": world.dt, **self._options}
        self._spoken = Spoken((batch_dim, len(world.agents), 0), True, self._length(world), options)
        self._sends = np.tile(np.array(speaks), (batch_dim, 1))
        #: What was said in the newest steps (N, R, M), the number of all steps, and in which one each episode has begun (N).
        self._said = deque(maxlen=self._spoken.channel.memory)
        self._steps, self._began = 0, np.zeros(batch_dim, np.int64)
        self._heard = torch.zeros(batch_dim, len(world.agents), len(world.agents), world.dim_c, device=device)
        world.zero_grad = self._zero_grad
        return world

    def to(self, device: torch.device) -> None:
        super().to(device)
        self._keep(said.to(device) for said in self._said)

    def reset_world_at(self, env_index: int | None = None) -> None:
        super().reset_world_at(env_index)
        channel, n = self._spoken.channel, self._spoken.size[0]
        if env_index is not None:
            channel.reset(np.arange(n) == env_index)
        elif self._options.get("seed") is None:
            # VMAS seeds this generator, too, and scenarios draw layouts with that of torch: they are those without a channel.
            channel.reset(seed=random.getrandbits(62))
        else:
            channel.reset()
        if env_index is None:
            self._said.clear()
        self._began[slice(None) if env_index is None else env_index] = self._steps
        self._listen()

    def pre_step(self) -> None:
        super().pre_step()
        world = self.world
        silence = torch.zeros_like(self._heard[:, 0, 0])
        said = torch.stack([silence if agent.silent else agent.action.c for agent in world.agents], 1)
        position = torch.stack([agent.state.pos for agent in world.agents], 1)
        if not said.isfinite().all():
            raise ValueError("actions: what an agent says is not finite")
        self._spoken.send(np.zeros(self._spoken.size, np.float32), position.detach().cpu().numpy(), sends=self._sends)
        self._said.append(said)
        self._steps += 1
        self._listen()

    def observation(self, agent: Agent) -> Any:
        listener = self.world.agents.index(agent)
        others = [(at, other) for at, other in enumerate(self.world.agents) if other is not agent and not other.silent]
        with heard_speech((other.state, "c", self._heard[:, listener, at]) for at, other in others):
            return super().observation(agent)

    def _zero_grad(self) -> None:
        """Ends a segment of truncated back-propagation, as ``zero_grad`` of a world does, also for what was said."""
        type(self.world).zero_grad(self.world)
        self._keep(said.detach() for said in self._said)
        self._heard = self._heard.detach()

    def _keep(self, said: Iterable[torch.Tensor]) -> None:
        self._said = deque(said, self._said.maxlen)

    def _length(self, world: World) -> int:
        return 40 + 4 * world.dim_c if self._bytes is None else self._bytes

    def _listen(self) -> None:
        """Looks up what each agent has last heard of each other one."""
        channel, (n, r, _) = self._spoken.channel, self._spoken.size
        if not self._said:
            self._heard = torch.zeros_like(self._heard)
            return
        step = self._began[:, None, None] + channel.index - self._steps + len(self._said)
        step = np.where(channel.heard, step, 0)
        # Most of what is remembered has been heard before, or is still on its way.
        used = np.bincount(step.ravel(), minlength=len(self._said)) > 0
        said = torch.stack([said for said, taken in zip(self._said, used) if taken])
        device = self.world.device
        at = torch.from_numpy((np.cumsum(used) - 1)[step]).to(device)
        environment, sender = torch.arange(n, device=device)[:, None, None], torch.arange(r, device=device)
        heard = torch.from_numpy(channel.heard.copy()).to(device)
        self._heard = said[at, environment, sender] * heard.unsqueeze(-1)


def _restored(of: str | type[BaseScenario], length: int | None, options: dict[str, Any]) -> BaseScenario:
    return spoken(of, bytes=length, **options)
