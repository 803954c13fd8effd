"""Policies in Python: in a simulation, and as a process that a host starts."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

import murmurate

#: A potential field: towards the goal, and away from neighbours, turned a little to the left.
CONTRACT = {
    "name": "field in Python",
    "rate_hz": 20,
    "radius_m": 2.0,
    "hold_s": 0.2,
    "observation": {"goal": {"source": "goal-minus-position", "shape": [2], "unit": "m", "frame": "world"}},
    "edges": {"features": ["relative-position"], "sign": "own-minus-theirs", "frame": "world"},
    "message": {"floats": 2},
    "state": {"floats": 1, "after_gap_s": 0.5},
    "action": {"kind": "velocity", "unit": "m/s", "frame": "world", "limit": 1.0},
}
TURN = np.array([[0.8, 0.6], [-0.6, 0.8]], np.float32)


class Field(murmurate.Policy):
    """The field of tests/onnx, with a state that counts the steps."""

    contract = CONTRACT

    def __init__(self, contract=CONTRACT):
        super().__init__(contract)
        self.seeds, self.counts = [], set()

    def reset(self, seed, robot):
        self.seeds.append((robot, seed))

    def step(self, inputs):
        goal = inputs.observation["goal"]
        wish = np.clip(1.5 * goal, -1, 1)
        push = inputs.edges / ((inputs.edges**2).sum(2, keepdims=True) + 1e-3) ** 1.5 @ TURN
        away = 0.12 * (push * inputs.heard[:, :, None]).sum(1)
        self.counts.add(float(inputs.state[0, 0]))
        return murmurate.Outputs(action=np.clip(wish + away, -1, 1), message=wish, state=np.minimum(inputs.state + 1, 1e3))


def test_an_object_drives_a_team_twice_alike():
    runs = [murmurate.sim("swap", Field(), robots=4, episodes=2, repeats=1) for _ in range(2)]
    assert runs[0].successes >= 1 and runs[0].policy == "field in Python"
    assert runs[0].trace_hash == runs[1].trace_hash


def test_what_it_remembers_goes_in_and_comes_out_and_a_reset_has_a_seed():
    policy = Field()
    murmurate.sim("swap", policy, robots=3, episodes=2, repeats=1)
    assert {0.0, 1.0, 2.0} < policy.counts
    # Three robots in two episodes, each with a seed of its own, and the same ones in the next run.
    assert sorted(robot for robot, _ in policy.seeds) == [0, 0, 1, 1, 2, 2] and len(set(policy.seeds)) == 6
    again = Field()
    murmurate.sim("swap", again, robots=3, episodes=2, repeats=1)
    assert again.seeds == policy.seeds


class Counted(Field):
    """Notes how many robots each call has, and draws random numbers from a generator of its own."""

    def __init__(self, contract=CONTRACT):
        super().__init__(contract)
        self.robots, self.places, self.drawn = [], set(), {}

    def reset(self, seed, robot):
        self.drawn = {**self.drawn, robot: np.random.default_rng(seed)}

    def step(self, inputs):
        outputs = super().step(inputs)
        if not self.drawn:
            # No robot has begun: it is being checked.
            return outputs
        self.robots.append(len(inputs.state))
        self.places |= {tuple(row) for row in inputs.heard.astype(int)}
        noise = [self.drawn[robot].normal(0, 0.05, 2) for robot in sorted(self.drawn)[: len(inputs.state)]]
        return murmurate.Outputs(outputs.action + np.array(noise), outputs.message, outputs.state)


def test_one_call_has_all_robots_of_an_agent():
    joint, apart = Counted(), Counted()
    together = murmurate.sim("swap", joint, robots=4, episodes=2, repeats=1)
    # The last ticks of an episode may lack robots whose percepts are late; in this mode there are none.
    assert set(joint.robots) == {4} and together.successes >= 1
    assert any(sum(row) < len(row) for row in joint.places), "places that a robot lacks are empty"
    murmurate.sim("swap", apart, mode="offboard", robots=4, episodes=1, repeats=1)
    assert set(apart.robots) == {1}


def test_a_function_makes_an_object_for_each_job_and_the_run_repeats_itself():
    made = []

    def make():
        made.append(Counted())
        return made[-1]

    runs = [murmurate.sim("swap", make, robots=3, episodes=1, repeats=4, jobs=jobs) for jobs in (1, 2)]
    assert len({id(policy) for policy in made}) == len(made) in (3, 4)
    assert runs[0].trace_hash == runs[1].trace_hash
    with pytest.raises(ValueError, match="give a function that makes one for each job"):
        murmurate.sim("swap", Field(), robots=2, jobs=2)


class Two(murmurate.Policy):
    """Says where it wants to go, and goes there."""

    contract = {name: value for name, value in CONTRACT.items() if name != "state"}

    def encode(self, inputs):
        return murmurate.Outputs(message=np.clip(inputs.observation["goal"], -1, 1))

    def act(self, inputs):
        assert inputs.messages.shape[2] == 2 and inputs.heard.shape == inputs.messages.shape[:2]
        return murmurate.Outputs(action=inputs.own_message)


def test_a_policy_may_make_its_message_first():
    assert murmurate.sim("swap", Two(Two.contract), mode="offboard", robots=2, episodes=1, repeats=1).episodes == 1


def test_what_is_wrong_is_said_before_a_run_with_the_line_of_the_policy():
    class Narrow(Field):
        def step(self, inputs):
            return murmurate.Outputs(action=np.zeros((1, 3)), message=np.zeros((1, 2)))

    class Fails(Field):
        def step(self, inputs):
            return murmurate.Outputs(action=1 / 0)

    class Infinite(Field):
        def step(self, inputs):
            with np.errstate(divide="ignore"):
                action = 1 / inputs.heard.sum(1, keepdims=True) * np.ones(2)
            return murmurate.Outputs(action=action, message=np.zeros((len(action), 2)))

    run = lambda policy: murmurate.sim("swap", policy, robots=2, episodes=1, repeats=1)
    with pytest.raises(ValueError, match=r"the output 'action' has the shape \[1, 3\], and the contract says \[1, 2\]"):
        run(Narrow())
    with pytest.raises(ValueError, match=r"ZeroDivisionError: division by zero \(test_policy.py, line \d+\)"):
        run(Fails())
    with pytest.raises(ValueError, match="no neighbour.*'action' is not finite"):
        run(Infinite())
    class Silent(Two):
        contract = {name: value for name, value in Two.contract.items() if name != "message"}

    with pytest.raises(ValueError, match="its contract no message"):
        run(Silent(Silent.contract))
    with pytest.raises(ValueError, match="has no contract"):
        run(object())


MODULE = """
import murmurate

class Straight(murmurate.Policy):
    def step(self, inputs):
        return murmurate.Outputs(action=inputs.observation["goal"])
"""
FILE = """
format = 3
name = "straight"
python = "straight:Straight"
rate_hz = 20
radius_m = 2.0
hold_s = 0.2

[observation.goal]
source = "goal-minus-position"
shape = [2]
unit = "m"
frame = "world"

[action]
kind = "velocity"
unit = "m/s"
frame = "world"
limit = 1.0
"""


def file_of(folder: pathlib.Path, contract: str = FILE) -> pathlib.Path:
    (folder / "straight.py").write_text(MODULE)
    path = folder / "straight.policy.toml"
    path.write_text(contract)
    return path


def test_a_file_names_a_class_that_a_process_of_its_own_runs(tmp_path, monkeypatch):
    import sys

    monkeypatch.setenv("PYTHON_OF_MURMURATE", sys.executable)
    monkeypatch.chdir(tmp_path)
    path = file_of(tmp_path)
    assert murmurate.sim("swap", path, robots=2, episodes=1, repeats=1).episodes == 1
    for named, words in [("straight:Curved", "has no 'Curved'"), ("curved:Straight", "No module named 'curved'")]:
        with pytest.raises(ValueError, match=words):
            murmurate.sim("swap", file_of(tmp_path, FILE.replace("straight:Straight", named)), robots=2, episodes=1)
