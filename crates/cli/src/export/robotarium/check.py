"""Compares the actor of this folder with what `murmurate` computed for the same team; numpy alone."""

import json
import os
import sys

import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, HERE)
from actor import Actor  # noqa: E402

TOLERANCE = 1e-4  # of numbers above 1 relative to them, as for the probe of a policy file


def largest(found, stored):
    stored = np.array(stored)
    return float(np.max(np.abs(found - stored) / np.maximum(np.abs(stored), 1.0)))


def main():
    with open(os.path.join(HERE, "experiment.json")) as file:
        experiment = json.load(file)
    experiment["policy"]["draw"] = "mean"
    actor = Actor(experiment, np.load(os.path.join(HERE, "weights.npy")))
    off = [0.0, 0.0]
    for step in experiment["probe"]:
        action, said = actor.step(step["position"], step["velocity"], step["goal"], step["half_turn"])
        off = [max(off[0], largest(said, step["message"])), max(off[1], largest(action, step["action"]))]
    print(f"largest difference: messages {off[0]:.1e}, actions {off[1]:.1e}")
    if not max(off) <= TOLERANCE:
        sys.exit(f"the actor is not the policy: more than {TOLERANCE}")


if __name__ == "__main__":
    main()
