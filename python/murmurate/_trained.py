"""Models of any trainer as policies, as they are: asked with the observations of their training."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ._contract import observed
from ._hops import Refused
from ._like import environment_of, seen_through
from .policy import Inputs, Outputs, Policy

#: Steps per second of an environment with ``repeat=1``.
RATE_HZ = 20.0


class Trained(Policy):
    """Policy that gives a function the observations of a :class:`murmurate.VecEnv`. :func:`trained` makes it."""

    def __init__(self, act: Callable[[np.ndarray], Any], like: Any, name: str) -> None:
        core, transforms = environment_of(like)
        if core.scan.shape[2]:
            raise Refused("like", None, "it has a lidar, whose contract has more fields: write a murmurate.Policy")
        self._act, (self._takes,) = act, observed(["observation"], None, list(core.observation_fields), "policy")
        self._seen = seen_through(transforms, core) if transforms else None
        observation = {
            one.name: {"source": one.source, "shape": list(one.shape), "unit": one.unit}
            | ({} if one.frame is None else {"frame": one.frame})
            for one in self._takes.inputs
        }
        action = {"kind": "velocity", "unit": "m/s", "frame": "policy", "limit": core.limit_m_s}
        super().__init__(
            {
                "name": name,
                "rate_hz": RATE_HZ,
                "radius_m": core.radius_m,
                "hold_s": core.hold_s,
                "observation": observation,
                "action": action,
            }
        )

    def step(self, inputs: Inputs) -> Outputs:
        """Asks the function for the velocities of all robots of the call."""
        parts = [sum(inputs.observation[one.name] for one in part) for part in self._takes.parts]
        observation = np.concatenate(parts, axis=1, dtype=np.float32)
        if self._seen is not None:
            import torch

            observation = self._seen.of(torch.from_numpy(observation)).numpy()
        return Outputs(action=self._act(observation))


def trained(act: Callable[[np.ndarray], Any], like: Any, *, name: str = "trained") -> Trained:
    """Returns a policy for :func:`murmurate.sim` of a trained model as it is: of Stable-Baselines3, RLlib, TorchRL, BenchMARL or yours.

    It says nothing to other robots. For robots, and for policies that speak, :func:`murmurate.export` and
    :func:`murmurate.export_graph` write files.

    Args:
        act: Returns the velocities [R, 2] [m/s], policy frame, for observations [R, F] as in ``like``. R is the number of
            robots that step together: all of the team in modes sim and centralized, else one.
        like: Environment of the training: a :class:`murmurate.VecEnv`, one of the faces, or one around them.
        name: Name of the policy in results.

    Raises:
        ValueError: ``like`` is no such environment, or a wrapper changes what the policy observes or commands.
    """
    try:
        return Trained(act, like, name)
    except Refused as refused:
        raise ValueError(str(refused)) from None
