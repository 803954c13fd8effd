"""Team, curriculum and hold time of a configuration are taken, or named."""

import json
import subprocess
import sys
import warnings

from lib_expect import WORK, expect, refused
from torch import nn

import murmurate

murmurate_program = sys.argv[1]
words = [murmurate_program, "train", "passage", "--print-config", "--robots", "7"]
file = WORK / "c7.toml"
file.write_text(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    expect(murmurate.VecEnv(config=str(file)).num_robots == 7, "the team is another one")
expect(any("curriculum" in str(one.message) for one in said), "no word of the curriculum")
with warnings.catch_warnings():
    warnings.simplefilter("error")
    last = murmurate.VecEnv(config=file, stage=-1)
expect((last.num_robots, last.repeat, last.hold_s) == (7, 2, 0.4), f"{last}: {last.repeat} steps, {last.hold_s} s")
refused(lambda: murmurate.VecEnv(config=file, stage=0), ValueError, "stage: its groups [[3, 4]] are not the whole team")
policy = murmurate.export(WORK / "p.safetensors", nn.Linear(6, 8), [], nn.Linear(8, 4), like=last)
told = json.loads(subprocess.run([murmurate_program, "policy", "check", policy, "--json"], capture_output=True, text=True).stdout)
expect(told["manifest"]["hold_s"] == 0.4, f"the file holds messages for {told['manifest']['hold_s']} s")
