"""The package with the parts of another crate, tests/stranger/python. Skipped where that is not installed."""

import importlib.metadata
import os

import numpy as np
import pytest

import murmurate
from murmurate import _module

there = importlib.metadata.entry_points(group=_module.GROUP)
# "just full-python" installs it, and runs this file then.
installed = pytest.mark.skipif(
    not there and not os.environ.get("FULL_TESTS"), reason="no package with parts of its own is installed"
)


@installed
def test_the_scenario_of_another_crate_is_here_as_the_built_in_ones_are(tmp_path):
    env = murmurate.VecEnv("round", 4, conditions="robust", message="observations")
    env.step(np.zeros((4, env.num_robots, 2), np.float32))
    assert np.isfinite(env.obs).all() and murmurate.VecEnv("passage").num_robots == 5
    assert murmurate.sim("round", "give-way", mode="offboard", episodes=2, repeats=1).successes == 2
    training = murmurate.train("round", steps=2000, out=tmp_path / "round", fields={"ppo.environments": 8})
    assert murmurate.sim("round", training.policy, episodes=1, repeats=1).episodes == 1


class Entry:
    """An entry point that loads a module of this version."""

    def __init__(self, version):
        self.value, self.dist, self.version = "parts", type("Dist", (), {"name": "a-package"}), version

    def load(self):
        return type("Module", (), {"__version__": self.version})


@pytest.mark.parametrize(
    "entries, why",
    [
        ([Entry("0"), Entry("0")], r"several packages have parts of their own, a-package \(parts\), a-package"),
        ([Entry("0.0.1")], "'parts' was built with version 0.0.1 and not"),
    ],
)
def test_a_module_that_cannot_be_used_is_refused_by_name(entries, why, monkeypatch):
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: entries)
    with pytest.raises(ImportError, match=why):
        _module._load()
