"""Trainings, studies and exports run in a folder that has files named like modules."""

import os
import subprocess
import sys

from lib_expect import WORK, expect

SCRIPT = """
import murmurate
from torch import nn
print(murmurate.sim(episodes=1, repeats=1).episodes)
fields = {"ppo.environments": 16, "ppo.decisions": 32, "ppo.minibatch": 256}
print(murmurate.train(out=OUT, steps=1000, threads=1, fields=fields).decisions)
print(murmurate.study("range", layouts=1, repeats=1, ranges_m=[1], policy="orca").study)
print(murmurate.export(OUT + ".safetensors", nn.Linear(6, 8), [], nn.Linear(8, 4), like=murmurate.VecEnv()).exists())
"""
script = WORK / "run.py"
script.write_text(SCRIPT.replace("OUT", repr(str(WORK / "out"))))
for module in ("signal", "json", "murmurate"):
    folder = WORK / f"with-{module}"
    folder.mkdir()
    (folder / f"{module}.py").write_text("")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    said = subprocess.run([sys.executable, script], cwd=folder, capture_output=True, text=True, env=environment)
    lines = said.stdout.split()
    expect(len(lines) == 4 and lines[2:] == ["range", "True"], f"with {module}.py: {said.stdout}{said.stderr[-600:]}")
    subprocess.run(["rm", "-rf", WORK / "out"], check=True)
