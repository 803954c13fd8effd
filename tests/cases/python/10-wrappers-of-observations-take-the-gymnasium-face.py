"""Wrappers of Gymnasium's vector API that transform observations work on the face."""

import numpy as np
from gymnasium.wrappers import vector
from lib_expect import expect

from murmurate.gymnasium import TeamVectorEnv

WRAPPERS = {
    "NormalizeObservation": vector.NormalizeObservation,
    "DtypeObservation": lambda env: vector.DtypeObservation(env, np.float64),
    "FlattenObservation": vector.FlattenObservation,
    "TransformObservation": lambda env: vector.TransformObservation(env, lambda obs: obs * 2),
}
for mode in ("disabled", "next-step"):
    for name, wrapper in WRAPPERS.items():
        if mode == "disabled" and name == "NormalizeObservation":
            continue  # Before version 1.3 of Gymnasium it takes the other mode alone.
        env = wrapper(TeamVectorEnv("passage", 4, autoreset=mode, episode_s=1.0))
        obs, _ = env.reset(seed=1)
        for _ in range(10):
            obs, *_ = env.step(env.action_space.sample())
        expect(obs.shape == (4, 30) and np.isfinite(obs).all(), f"{name} with {mode}")
env = TeamVectorEnv("passage", 2, episode_s=0.1)
env.reset(seed=1)
for _ in range(2):
    *_, infos = env.step(env.action_space.sample())
expect({"final_obs", "_final_obs", "final_info", "_final_info"} <= set(infos), f"infos has {sorted(infos)}")
