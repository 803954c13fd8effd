"""The Gymnasium face refuses actions of another shape or kind than its space has."""

import numpy as np
from lib_expect import expect, refused

from murmurate.gymnasium import TeamVectorEnv

env = TeamVectorEnv("passage", 4, seed=0)
actions = np.random.default_rng(0).uniform(-0.9, 0.9, (4, 10)).astype(np.float32)
before = env.core.state()
for given, words in {
    "transposed": (np.ascontiguousarray(actions.T), "its shape is [10, 4] and not [4, 10]"),
    "split": (actions.reshape(20, 2), "its shape is [20, 2]"),
    "flat": (actions.ravel(), "its shape is [40]"),
    "texts": (actions.astype(str), "its type is <U"),
    "complex": (actions.astype(np.complex64), "its type is complex64"),
    "bool": (actions > 0, "its type is bool"),
}.values():
    refused(lambda given=given: env.step(given), ValueError, f"actions: {words}")
expect(env.core.state() == before, "something has changed")
expect(env.step(actions)[0].shape == (4, 30), "right actions are not taken")
