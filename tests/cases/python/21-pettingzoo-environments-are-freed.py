"""A dropped environment is freed, whatever was asked of it."""

import gc
import weakref

from lib_expect import expect

from murmurate.gymnasium import TeamEnv, TeamVectorEnv
from murmurate.pettingzoo import parallel_env

for make in (parallel_env, TeamEnv, TeamVectorEnv):
    env = make("passage")
    env.reset(seed=1)
    for agent in getattr(env, "possible_agents", []):
        env.action_space(agent).sample()
        env.observation_space(agent)
    seen = weakref.ref(env)
    del env
    gc.collect()
    expect(seen() is None, f"{make.__name__} is kept")
env = parallel_env("passage")
expect(env.action_space("robot_0") is env.action_space("robot_0"), "a space is another one each time")
