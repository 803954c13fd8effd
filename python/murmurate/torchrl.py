"""Many teams as an environment of TorchRL (``pip install torchrl``), with resets of single teams by a mask; and messages
with delay, loss and contention for environments of others, by a transform."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase, Transform

from ._faces import Begun, Spoken, refuse
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


class Messages(Transform):
    """Lets the agents of an environment say something to each other, over a :class:`murmurate.Channel`.

    The policy writes one more action, ``(group, "message")`` (N, R, M): what each of the R agents says. In the next step each
    one observes ``(group, "messages")`` (N, R, R, M), ``(group, "heard")`` and ``(group, "age")`` (N, R, R): the newest
    message that it has of each other one, whether there is one, and the time since it was sent [s]. All are by receiver and
    then by sender. The environment itself does not know of messages::

        env = TransformedEnv(VmasEnv("navigation", num_envs=64), Messages(8, radio="wifi", period_s=0.1))

    With ``said`` agents also say what is known of them, so that others learn from messages what a simulator would tell at
    once: ``Messages(said=positions_of)`` is where each one was, ``Messages(said="observation")`` is what it has observed, of
    which a network makes the latent at the receiver as well as at the sender.

    Args:
        floats: Number of floats of a message that the policy chooses. 0: it chooses none, and there is no further action.
        said: What agents say after them: a key of the group, whose value is (N, R, K), or a function of the environment
            without transforms that returns that. Then M is ``floats + K``.
        group: Key of the agents' part of a tensordict.
        position: Function of the environment without transforms that returns the positions of the agents [m] (N, R, 2);
            needed with ``range_m`` or a radio with a range. :func:`positions_of` is that of VMAS.
        bytes: Length of a datagram [bytes]; None is 4 for each float, and 40 for all else that a team says of itself.
        send_key: Key of a bool (N, R) in the group, which the policy writes as well: whether an agent sends. None: all do.
        options: Further arguments of the channel. Without ``seed`` its numbers follow those of torch at each reset of all
            environments: ``torch.manual_seed`` and the environment's ``set_seed`` make rollouts equal.

    Raises:
        ValueError: An argument is wrong, or the environment has no batch of one dimension with such a group; or a step lacks
            what agents say.
    """

    def __init__(
        self,
        floats: int = 0,
        *,
        said: str | Callable[[EnvBase], torch.Tensor] | None = None,
        group: str = "agents",
        position: Callable[[EnvBase], torch.Tensor] | None = None,
        bytes: int | None = None,
        send_key: str | None = None,
        **options: Any,
    ) -> None:
        super().__init__(in_keys=[], out_keys=[(group, key) for key in ("messages", "heard", "age")])
        if floats == 0 and said is None:
            raise ValueError("floats: it is 0, and without 'said' a message is empty")
        self.floats, self.said, self.group, self.position = floats, said, group, position
        self.bytes, self.send_key, self.options = bytes, send_key, options
        self._made: Spoken | None = None

    @property
    def spoken(self) -> Spoken:
        """The channel of the environment, which is made when it is first known how many agents there are."""
        if self._made is None:
            base = self.parent.base_env
            spec = base.full_observation_spec
            shape = tuple(spec[self.group].shape) if self.group in spec.keys() else ()
            if len(shape) != 2:
                keys, batch = ", ".join(map(str, spec.keys())), tuple(base.batch_size)
                why = f"the environment has no agents (N, R) under '{self.group}', but {keys} and a batch of {batch}"
                raise ValueError(f"group: {why}")
            size = (*shape, self.floats + self._known(base, spec[self.group], shape))
            self._made = Spoken(size, self.position is not None, self.bytes, self.options)
        return self._made

    def clone(self) -> Messages:
        """Returns a transform with the same arguments, for another environment."""
        cloned = super().clone()
        cloned._made = None
        return cloned

    def _known(self, base: EnvBase, observed: Composite, shape: tuple[int, ...]) -> int:
        """Number of floats K of what agents say without the policy."""
        if self.said is None:
            return 0
        if callable(self.said):
            known = tuple(self.said(base).shape)
        elif self.said in observed.keys():
            known = tuple(observed[self.said].shape)
        else:
            raise ValueError(f"said: the group '{self.group}' has no '{self.said}', but {', '.join(map(str, observed.keys()))}")
        if len(known) != 3 or known[:2] != shape:
            raise ValueError(f"said: its shape is {list(known)} and not {list(shape)} and a number of floats")
        return known[2]

    def _message(self, tensordict: TensorDictBase) -> torch.Tensor:
        """What the agents say in this step (N, R, M)."""
        chosen = self._written(tensordict, "message") if self.floats else None
        if self.said is None:
            return chosen
        known = self.said(self.parent.base_env) if callable(self.said) else self._written(tensordict, self.said)
        return known if chosen is None else torch.cat([chosen.to(known), known], -1)

    def _written(self, tensordict: TensorDictBase, key: str) -> torch.Tensor:
        value = tensordict.get((self.group, key), None)
        if value is None:
            why = "the policy has not written it, or a transform drops it"
            raise ValueError(f"{key}: a step has no ('{self.group}', '{key}'), which agents need to speak; {why}")
        return value

    def _heard(self, tensordict: TensorDictBase) -> TensorDictBase:
        channel = self.spoken.channel
        for key, array in (("messages", channel.said), ("heard", channel.heard), ("age", channel.age)):
            tensordict.set((self.group, key), torch.from_numpy(array).clone().to(self.parent.device))
        return tensordict

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        # Before the environment moves.
        if self.parent is not None:
            message = self._message(tensordict)
            numpy = lambda value: np.ascontiguousarray(value.detach().cpu().numpy())
            sends = None if self.send_key is None else numpy(self._written(tensordict, self.send_key).bool())
            position = None if self.position is None else numpy(self.position(self.parent.base_env))
            self.spoken.send(numpy(message.to(torch.float32)), position, sends=sends)
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._heard(next_tensordict)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        channel, n = self.spoken.channel, self.spoken.size[0]
        masks = [] if tensordict is None else [tensordict.get(key, None) for key in self.parent.reset_keys]
        masks = [mask.reshape(n, -1).any(1) for mask in masks if mask is not None]
        if masks:
            channel.reset(torch.stack(masks).any(0).cpu().numpy())
        elif self.options.get("seed") is None:
            # The transform has no part in set_seed of the environment, whose seed is its own.
            channel.reset(seed=int(torch.randint(2**62, (1,))))
        else:
            channel.reset()
        return self._heard(tensordict_reset)

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        n, r = self.spoken.size[:2]
        device, acted = self.parent.device, input_spec["full_action_spec", self.group]
        if self.floats:
            acted["message"] = Unbounded((n, r, self.floats), device=device)
        if self.send_key is not None:
            acted[self.send_key] = Categorical(2, shape=(n, r), dtype=torch.bool, device=device)
        return input_spec

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        n, r, floats = self.spoken.size
        device, observed = self.parent.device, observation_spec[self.group]
        observed["messages"] = Unbounded((n, r, r, floats), device=device)
        observed["heard"] = Binary(n=r, shape=(n, r, r), dtype=torch.bool, device=device)
        observed["age"] = Unbounded((n, r, r), device=device)
        return observation_spec


def positions_of(env: EnvBase) -> torch.Tensor:
    """Positions [m] (N, R, 2) of the agents of an environment of VMAS, for :class:`Messages`."""
    return torch.stack([agent.state.pos for agent in env.agents], 1)


def edges_of(heard: torch.Tensor) -> torch.Tensor:
    """Edges (2, E) of all graphs of a batch, as PyTorch Geometric takes them: from each agent to those that have heard it.

    ``heard`` is a bool (..., R, R), by receiver and then by sender. Agent r of the graph n is the node ``n * R + r``. The
    order of the edges is that of ``messages[heard]``.
    """
    r = heard.shape[-1]
    graph, receiver, sender = heard.bool().reshape(-1, r, r).nonzero(as_tuple=True)
    return torch.stack([graph * r + sender, graph * r + receiver])
