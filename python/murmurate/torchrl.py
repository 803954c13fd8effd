"""Many teams as an environment of TorchRL (``pip install torchrl``), with resets of single teams by a mask."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from ._faces import Begun, refuse
from ._module import VecEnv
from ._scenario import Task


class Env(EnvBase):
    """Batch of N teams; the group ``agents`` has the R robots of each.

    Keys are ``("agents", "observation")`` (N, R, F), ``("agents", "action")`` (N, R, 2), ``("agents", "reward")``
    (N, R, 1), and with messages ``("agents", "heard")``, ``("agents", "age")`` (N, R, R), ``("agents", "said")``
    (N, R, R, M), by receiver and then by sender, and with a lidar (``senses``) ``("agents", "scan")`` (N, R, K), with a task in Python
    that observes ``("agents", "observed")`` (N, R, K). With ``message="action"`` the policy also writes
    ``("agents", "message")`` (N, R, M). Arguments are those of :class:`murmurate.VecEnv`, without ``autoreset``. With
    ``seed=None``, the default, the seed is drawn. ``core`` is the :class:`murmurate.VecEnv` within. The environment runs on
    the processor; with ``.to(device)`` its tensors are on that device.

    Raises:
        ValueError: An argument is wrong, or not for this face; the message names it.
    """

    batch_locked = True
    _has_dynamic_specs = False

    def __init__(
        self,
        scenario: Task = "passage",
        num_envs: int = 1,
        *,
        seed: int | None = None,
        **options: Any,
    ) -> None:
        refuse(options, {"autoreset": "TorchRL resets environments itself"})
        core = VecEnv(scenario, num_envs, autoreset="disabled", seed=seed, **options)
        super().__init__(device="cpu", batch_size=torch.Size([core.num_envs]))
        self.core, self._begun = core, Begun(core, seed)
        n, r, f = core.obs.shape
        self._message = core.message
        self.group_map = {"agents": [f"robot_{robot}" for robot in range(r)]}
        observed: dict[str, Any] = {"observation": Unbounded((n, r, f))}
        acted: dict[str, Any] = {"action": Bounded(-core.limit_m_s, core.limit_m_s, (n, r, 2))}
        if core.scan.shape[2]:
            observed["scan"] = Unbounded((n, r, core.scan.shape[2]))
        if core.observed.shape[2]:
            observed["observed"] = Unbounded((n, r, core.observed.shape[2]))
        if self._message:
            m = core.said.shape[3]
            observed["heard"] = Binary(n=r, shape=(n, r, r), dtype=torch.bool)
            observed["age"] = Unbounded((n, r, r))
            observed["said"] = Unbounded((n, r, r, m))
        if self._message == "action":
            acted["message"] = Unbounded((n, r, core.said.shape[3]))
        group = lambda entries: Composite({"agents": Composite(entries, shape=(n, r))}, shape=(n,))
        self.observation_spec = group(observed)
        self.action_spec = group(acted)
        self.reward_spec = group({"reward": Unbounded((n, r, 1))})
        flag = lambda: Categorical(2, shape=(n, 1), dtype=torch.bool)
        self.done_spec = Composite({"done": flag(), "terminated": flag(), "truncated": flag()}, shape=(n,))

    def forward(self) -> Env:
        """Returns a copy: ``ParallelEnv(2, env)`` calls what it is given, as a function that makes an environment."""
        return copy.deepcopy(self)

    def _set_seed(self, seed: int | None) -> None:
        # As everywhere: without a seed, one is drawn.
        self._begun = Begun(self.core, seed)
        self._begun.reset(None if seed is None else int(seed))

    def _seen(self) -> dict[str, torch.Tensor]:
        names = [name for name in ("scan", "observed") if getattr(self.core, name).shape[2]]
        names += ["heard", "age", "said"] * bool(self._message)
        keys = {"observation": "obs"} | {name: name for name in names}
        return {key: torch.from_numpy(getattr(self.core, name)).clone() for key, name in keys.items()}

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        mask = tensordict.get("_reset", None) if tensordict is not None else None
        self._begun.reset(None, None if mask is None else np.ascontiguousarray(mask.squeeze(-1).cpu().numpy()))
        n, r = self.core.num_envs, self.core.num_robots
        ended = {key: torch.zeros(n, 1, dtype=torch.bool) for key in ("done", "terminated", "truncated")}
        return TensorDict({"agents": TensorDict(self._seen(), (n, r)), **ended}, (n,)).to(self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        core, agents = self.core, tensordict["agents"]
        given = lambda key: agents[key].detach().cpu().contiguous().numpy()
        core.step(given("action"), given("message") if self._message == "action" else None)
        n, r = core.num_envs, core.num_robots
        reward = torch.from_numpy(core.reward).clone().unsqueeze(-1)
        terminated = torch.from_numpy(core.terminated).clone().unsqueeze(-1)
        truncated = torch.from_numpy(core.truncated).clone().unsqueeze(-1)
        ended = {"done": terminated | truncated, "terminated": terminated, "truncated": truncated}
        return TensorDict({"agents": TensorDict(self._seen() | {"reward": reward}, (n, r)), **ended}, (n,)).to(self.device)
