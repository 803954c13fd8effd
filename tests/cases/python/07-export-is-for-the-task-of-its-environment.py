"""A policy of an environment of swap is exported for swap."""

import json
import subprocess
import sys

from lib_expect import WORK, expect, refused
from torch import nn

import murmurate
from murmurate.torchrl import Env

parts = nn.Linear(6, 8), [], nn.Linear(8, 4)
for like in (murmurate.VecEnv("swap"), Env("swap", 2)):
    file = murmurate.export(WORK / "p.safetensors", *parts, like=like)
    words = [sys.executable, "-P", "-m", "murmurate", "policy", "check", file, "--json"]
    said = json.loads(subprocess.run(words, capture_output=True, text=True).stdout)["manifest"]["scenario"]
    expect(said == "swap", f"its scenario is {said}")
expect(murmurate.sim("swap", file, episodes=1, repeats=1).episodes == 1, "it does not run in swap")
expect(murmurate.VecEnv("swap").scenario == "swap", "an environment does not say its scenario")
refused(lambda: murmurate.sim("passage", file, episodes=1, repeats=1), ValueError, "swap")
refused(lambda: murmurate.export(file, *parts, like=like, scenario="pasage"), ValueError, "pasage")
