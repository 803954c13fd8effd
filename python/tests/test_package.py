"""The package on its own: buffers, refusals, bits, simulations and the command line. Runs with numpy and pytest alone."""

import os
import pathlib
import pickle
import subprocess
import sys

import numpy as np
import pytest

import murmurate
from murmurate import VecEnv


def zeros(env):
    return np.zeros((env.num_envs, env.num_robots, 2), np.float32)


def rolled(num_envs, first, *, threads=1, masked=None, **options):
    """Everything that the buffers of the first environments hold in 60 steps towards the goals, as bytes."""
    env = VecEnv("passage", num_envs, threads=threads, conditions="late", message="observations", episode_s=1.0, **options)
    seen = []
    for step in range(60):
        env.step(np.ascontiguousarray(np.clip(env.obs[:, :, :2], -1, 1)))
        if step == 30 and masked is not None:
            mask = np.zeros(num_envs, bool)
            mask[masked] = True
            env.reset(mask)
        buffers = (env.obs, env.last_obs, env.reward, env.terminated, env.truncated, env.arrived, env.heard, env.age, env.said)
        seen += [buffer[:first].tobytes() for buffer in buffers]
    return seen


def test_bits_do_not_depend_on_threads_batch_or_resets_of_others():
    alone = rolled(3, 3)
    assert alone == rolled(70, 3)
    assert alone == rolled(70, 3, threads=2)
    assert alone == rolled(70, 3, masked=50)
    assert alone != rolled(3, 3, masked=1)
    assert alone != rolled(3, 3, seed=1)


def test_buffers_are_owned_and_filled_in_place():
    env = VecEnv("passage", 4, message="action", message_size=3)
    obs, said = env.obs, env.said
    assert obs.shape == (4, 5, 6) and said.shape == (4, 5, 5, 3) and env.observation_fields[0] == "goal-minus-position"
    before = obs.copy()
    words = np.arange(60, dtype=np.float32).reshape(4, 5, 3)
    env.step(np.ones_like(zeros(env)), words)
    assert env.obs is obs and not np.array_equal(before, obs)
    assert env.heard.any() and not env.heard[:, range(5), range(5)].any()
    n, receiver, sender = np.nonzero(env.heard)
    assert np.array_equal(said[n, receiver, sender], words[n, sender])
    assert np.array_equal(env.age[env.heard], np.full(env.heard.sum(), 0.05, np.float32))


def test_a_reset_touches_only_what_the_mask_names_and_a_seed_begins_anew():
    env = VecEnv("swap", 3, num_robots=4, autoreset="disabled")
    env.step(np.ones_like(zeros(env)))
    before = env.obs.copy()
    env.reset(np.array([False, True, False]))
    assert np.array_equal(env.obs[[0, 2]], before[[0, 2]]) and not np.array_equal(env.obs[1], before[1])
    env.reset(seed=5)
    first = env.obs.copy()
    env.step(zeros(env))
    env.reset(seed=5)
    assert np.array_equal(first, env.obs)


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda a: a[:, :, :1], "shape"),
        (lambda a: a.astype(np.float64), "type"),
        (lambda a: np.asfortranarray(a), "contiguous"),
        (lambda a: a + np.float32("nan"), "nan"),
        (lambda a: a + np.float32("inf"), "inf"),
        (lambda a: a.tolist(), "numpy"),
        (lambda a: None, "numpy"),
    ],
)
def test_wrong_actions_are_refused_by_name(change, words):
    env = VecEnv("passage", 2)
    with pytest.raises(ValueError, match=f"actions: .*(?i:{words})"):
        env.step(change(zeros(env)))
    env.step(zeros(env))


@pytest.mark.parametrize(
    "options, argument",
    [
        ({"scenario": "nowhere"}, "scenario"),
        ({"num_envs": 0}, "num_envs"),
        ({"threads": 0}, "threads"),
        ({"conditions": "good"}, "conditions"),
        ({"message": "words"}, "message"),
        ({"message": "action", "message_size": 0}, "message_size"),
        ({"autoreset": "next-step"}, "autoreset"),
        ({"num_robots": 10_000}, "scenario"),
        ({"hull_m": 0.4}, "hull_m"),
        ({"scale": 0.0}, "scale"),
        ({"gap_m": 0.3}, "gap_m"),
        ({"episode_s": float("nan")}, "episode_s"),
        ({"config": "nothing.toml"}, "config"),
        ({"conditions": "late", "radio": "tin-cans"}, "radio"),
        ({"conditions": "late", "radio": "nothing.toml"}, "cannot read the medium file 'nothing.toml'"),
        ({"radio": "wifi"}, "radio"),
        ({"filtered": 1.0}, "filtered"),
        ({"conditions": "late", "filtered": 1.5}, "filtered"),
        ({"senses": "nothing.toml"}, "senses"),
    ],
)
def test_wrong_arguments_are_refused_by_name(options, argument):
    with pytest.raises(ValueError, match=f"^{argument}"):
        VecEnv(**options)


def test_a_lidar_scans_what_is_about_each_robot(tmp_path):
    def senses(text):
        (tmp_path / "senses.toml").write_text("[senses.eyes]\n" + text)
        return tmp_path / "senses.toml"

    lidar = "kind = 'lidar'\nrays = 16\nrange_m = 2.0\n"
    env = VecEnv("swap", 3, num_robots=4, senses=senses(lidar), autoreset="disabled", seed=5)
    assert env.scan.shape == env.last_scan.shape == (3, 4, 16) and env.scan.dtype == np.float32
    assert VecEnv("swap", 3, num_robots=4).scan.shape == (3, 4, 0)
    for _ in range(20):
        env.step(zeros(env))
        # The robots stand on open ground: the nearest echo is the nearest hull, or the rails.
        assert env.scan.min() > 0.3 and env.scan.max() == 2.0 and np.array_equal(env.scan, env.last_scan)
    before = env.scan.copy()
    ahead = zeros(env)
    ahead[:, 0, 0] = 1.0
    for _ in range(12):
        env.step(ahead)
    moved = np.abs(env.scan - before).max(axis=2)
    assert (moved[:, 0] > 0.05).all(), "the first robot of each team has moved"
    assert np.array_equal(env.copy().scan, env.scan) and np.array_equal(pickle.loads(pickle.dumps(env)).scan, env.scan)
    noisy = VecEnv("swap", 3, senses=senses(lidar + "noise_m = 0.05\n"))
    noisy.step(zeros(noisy))
    assert len(np.unique(noisy.scan[noisy.scan < 2.0])) > 50
    for text, field in [("kind = 'relative'\nmost = 2\nrange_m = 1.0", "kind"), (lidar + "delay_s = 0.1", "delay_s")]:
        with pytest.raises(ValueError, match=f"^senses.eyes.{field}"):
            VecEnv("swap", senses=senses(text))
    tasks = pathlib.Path(__file__).parents[2] / "examples/tasks"
    field = str(tasks / "navigation.toml")
    assert VecEnv(field, 2).scan.shape == (2, 8, 24), "the task file has a lidar"
    assert VecEnv(field, 2, senses=senses(lidar.replace("16", "4"))).scan.shape == (2, 8, 4)
    assert VecEnv(str(tasks / "four-rooms.toml"), 2).scan.shape == (2, 6, 0)


def test_late_messages_are_those_of_the_medium_that_is_asked_for():
    def age(radio):
        env = VecEnv("passage", 200, conditions="late", message="observations", radio=radio)
        ages = []
        for _ in range(40):
            env.step(zeros(env))
            ages.extend(env.age[env.heard])
        return np.mean(ages)

    assert age("wifi") == age("wifi") < 0.8 * age("paper")


def test_the_safety_filter_keeps_robots_apart_that_drive_at_each_other():
    def nearest(filtered):
        env = VecEnv("passage", 64, conditions="late", filtered=filtered, autoreset="disabled", seed=3)
        at = env.observation_fields.index("position") * 2
        least = np.inf
        for _ in range(160):
            where = env.obs[..., at : at + 2]
            env.step(np.clip(where.mean(axis=1, keepdims=True) - where, -1, 1).astype(np.float32))
            between = np.linalg.norm(env.obs[:, :, None, at : at + 2] - env.obs[:, None, :, at : at + 2], axis=-1)
            least = min(least, (between + 10 * np.eye(env.num_robots)).min())
        return least

    # Robots touch at 0.4 m; of 100 000 observed distances the worst is some 0.06 m off.
    assert nearest(1.0) > 0.33 and nearest(0.0) < 0.2


def test_messages_and_masks_are_checked():
    env = VecEnv("passage", 2, message="action", message_size=2)
    with pytest.raises(ValueError, match="messages: missing"):
        env.step(zeros(env))
    with pytest.raises(ValueError, match="mask: its type"):
        env.reset(np.zeros(2, np.int8))
    with pytest.raises(ValueError, match="mask: its shape"):
        env.reset(np.zeros(3, bool))
    with pytest.raises(ValueError, match="seed: "):
        env.reset(np.zeros(2, bool), seed=1)
    with pytest.raises(ValueError, match="messages: only"):
        VecEnv("passage", 2).step(zeros(env), np.zeros((2, 5, 2), np.float32))


def program(*arguments):
    return subprocess.run([sys.executable, "-m", "murmurate", *arguments], capture_output=True, text=True, timeout=300)


def test_the_command_line_names_itself_as_the_program_does():
    said = program("sim", "--no-such-flag")
    assert said.returncode == 2 and "see 'murmurate --help'" in said.stderr, said.stderr
    assert program("--help").stdout.count("Usage: murmurate") == 1


def test_a_simulation_is_that_of_the_program():
    results = murmurate.sim("passage", mode="offboard", episodes=2, repeats=2, seed=3)
    assert (results.episodes, results.robots, results.mode) == (4, 5, "offboard")
    said = program("sim", "--mode", "offboard", "--episodes", "2", "--repeats", "2", "--seed", "3", "--json", "--quiet")
    assert said.returncode == 0 and f'"trace_hash":"{results.trace_hash}"' in said.stdout, said.stderr


def test_a_launch_starts_its_hosts_with_the_same_interpreter():
    team = os.path.join(os.path.dirname(__file__), "..", "..", "teams", "offboard.toml")
    number = 1000 + os.getpid() % 60_000
    sets = ["--set", f"team={number}", "--set", "episodes=1", "--set", "robots=2"]
    said = program("launch", team, *sets, "--json", "--quiet")
    assert said.returncode == 0 and '"episodes":1' in said.stdout, said.stderr


def test_wrong_flags_of_a_simulation_are_named():
    with pytest.raises(ValueError, match="--loss"):
        murmurate.sim(loss=2)
    with pytest.raises(ValueError, match="--nothing"):
        murmurate.sim(nothing=1)
    with pytest.raises(ValueError, match="nowhere"):
        murmurate.sim("nowhere")
    assert program("sim", "--loss", "2").returncode == 2
