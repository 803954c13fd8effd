"""Scenarios as tasks of BenchMARL (``pip install benchmarl torch_geometric``), for its IPPO, MAPPO and others; and tasks of
others whose agents hear each other over a channel, with a graph network for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from benchmarl.environments import TaskClass
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Composite, Unbounded
from torchrl.envs import EnvBase

from ._faces import NO_MESSAGES, refuse
from ._heard import HeardGnn, HeardGnnConfig, with_messages  # noqa: F401 (part of this module)
from ._module import VecEnv
from ._scenario import Task as Scenarios
from .torchrl import Env


class _Env(Env):
    """Batch of teams whose group may have ``position`` and ``velocity``."""

    def __init__(self, *arguments: Any, edges: bool, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._edges = edges
        if not edges:
            return
        fields = self.core.observation_fields
        # A velocity is observed as such, or is what is added to the position.
        velocity = "velocity" if "velocity" in fields else "position-plus-velocity"
        missing = [field for field in ("position", velocity) if field not in fields]
        if missing:
            raise ValueError(f"edges: the observation does not have '{missing[0]}'")
        self._added = velocity != "velocity"
        self._at, self._ahead = (2 * fields.index(field) for field in ("position", velocity))
        n, r = self.core.num_envs, self.core.num_robots
        spec = self.observation_spec.clone()
        for key in ("position", "velocity"):
            spec["agents", key] = Unbounded((n, r, 2))
        self.observation_spec = spec

    def _seen(self) -> dict[str, torch.Tensor]:
        seen = super()._seen()
        if not self._edges:
            return seen
        position, ahead = (seen["observation"][..., at : at + 2] for at in (self._at, self._ahead))
        return seen | {"position": position.clone(), "velocity": ahead - position if self._added else ahead.clone()}


class Task(TaskClass):
    """A scenario as a task of BenchMARL: ``Task("passage", conditions="robust")``.

    One group, ``agents``, with the key ``observation`` (R, F) and actions that are velocities [m/s], policy frame. Messages
    are those of a GNN of BenchMARL within the actor: they have no delay and no loss, whatever ``conditions`` are.

    Args:
        scenario: Name of the scenario, a task file, or a task in Python (:class:`murmurate.Scenario`).
        edges: Whether the group also has the keys ``position`` [m] and ``velocity`` [m/s], policy frame, of which a GNN of
            BenchMARL makes the features of edges (its ``position_key`` and ``velocity_key``).
        repeat: Number of steps of 50 ms for which an action is held; its rewards are added. Four learn faster than one. None
            takes that of the ``stage``, else 1.
        options: Arguments of :class:`murmurate.VecEnv`, without ``num_envs``, ``autoreset``, ``message`` and ``seed``.

    Raises:
        ValueError: An argument is wrong, or not for a task of BenchMARL; the message names it.
    """

    def __init__(
        self,
        scenario: Scenarios = "passage",
        *,
        edges: bool = False,
        repeat: int | None = None,
        **options: Any,
    ) -> None:
        refuse(options, NO_MESSAGES | dict.fromkeys(("num_envs", "autoreset", "seed"), "BenchMARL says it"))
        #: Name, file or task in Python.
        self.scenario = scenario
        # A name for logs.
        name = scenario if isinstance(scenario, str) else VecEnv(scenario, 1, **{"repeat": repeat} | options).scenario
        super().__init__(name, {"edges": edges, "repeat": repeat} | options)
        # Mistakes are named here, not when an experiment begins.
        self.environment()

    def environment(self, num_envs: int = 1) -> VecEnv:
        """Returns the environment of this task, as ``murmurate.export`` takes it for ``like``."""
        return VecEnv(self.scenario, num_envs, **self._options())

    def _options(self) -> dict[str, Any]:
        return {name: value for name, value in self.config.items() if name != "edges"}

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        return lambda: _Env(self.scenario, num_envs, seed=seed, **self.config).to(device)

    def supports_continuous_actions(self) -> bool:
        return True

    def supports_discrete_actions(self) -> bool:
        return False

    def max_steps(self, env: EnvBase) -> int:
        return self.environment().episode_steps

    def has_render(self, env: EnvBase) -> bool:
        return False

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        return env.full_observation_spec_unbatched.clone()

    def action_spec(self, env: EnvBase) -> Composite:
        return env.full_action_spec_unbatched.clone()

    def info_spec(self, env: EnvBase) -> None:
        return None

    def state_spec(self, env: EnvBase) -> None:
        return None

    def action_mask_spec(self, env: EnvBase) -> None:
        return None

    @staticmethod
    def env_name() -> str:
        return "murmurate"

    @staticmethod
    def log_info(batch: TensorDictBase) -> dict[str, float]:
        """Share of the batch's ended episodes in which all robots arrived, 0 to 1, if any ended."""
        ended = batch["next", "done"].sum().item()
        arrived = batch["next", "terminated"].sum().item()
        return {"collection/info/arrived": arrived / ended} if ended else {}
