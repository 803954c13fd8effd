"""After the end of an episode, and before the first, the PettingZoo face says what comes first."""

import numpy as np
from lib_expect import expect, refused

from murmurate.pettingzoo import parallel_env

env = parallel_env("passage", episode_s=0.5)
actions = {agent: np.zeros(2, np.float32) for agent in env.possible_agents}
refused(lambda: env.step(actions), RuntimeError, "call reset() first")
env.reset(seed=0)
while env.agents:
    env.step(actions)
refused(lambda: env.step(actions), RuntimeError, "call reset() first")
expect(env.step({}) == ({}, {}, {}, {}, {}), "step({}) is not five times {}")
env.reset()
expect(len(env.step(actions)[0]) == 5, "a new episode does not begin")
