"""Arguments of environments: each wrong one is a ValueError that begins with its name; and what a configuration says."""

import pathlib
import resource
import subprocess
import sys
import warnings

import numpy as np
import pytest

import murmurate
from murmurate import VecEnv


@pytest.mark.parametrize(
    "options, argument",
    [
        ({"num_envs": -1}, "num_envs: -1 is not 1 to"),
        ({"num_envs": 2**70}, "num_envs: "),
        ({"num_envs": 2.5}, "num_envs: 2.5"),
        ({"num_envs": "4"}, "num_envs: '4'"),
        ({"threads": -2}, "threads: -2"),
        ({"num_robots": -5}, "num_robots: -5"),
        ({"message": "action", "message_size": -1}, "message_size: -1"),
        ({"message_size": 8}, "message_size: it has no effect"),
        ({"message": 5}, "message: 5"),
        ({"seed": -1}, "seed: -1"),
        ({"seed": 2**64}, "seed: "),
        ({"seed": 0.5}, "seed: 0.5"),
        ({"seed": "x"}, "seed: 'x'"),
        ({"repeat": 0}, "repeat: 0"),
        ({"repeat": -3}, "repeat: -3"),
        ({"gap_m": -0.5}, "gap_m: -0.5"),
        ({"gap_m": "wide"}, "gap_m: 'wide'"),
        ({"gap_m": float("inf")}, "gap_m: inf"),
        ({"episode_s": -1.0}, "episode_s: -1.0"),
        ({"penalties": -1}, "penalties: -1"),
        ({"conditions": "late", "filtered": -0.1}, "filtered: -0.1"),
        ({"stage": 99}, "stage: 99"),
        ({"stage": 0}, r"stage: its groups \[\[2, 3\]\] are not the whole team of 5"),
        ({"scenario": None, "num_robots": 1000}, "scenario: "),
        ({"scenario": 7}, "scenario: 7"),
        ({"config": 7}, "config: 7"),
        ({"config": pathlib.Path("nothing.toml")}, "config: 'nothing.toml' is neither a preset nor a file"),
        ({"conditions": "late", "radio": pathlib.Path("nothing.toml")}, "cannot read the medium file"),
    ],
)
def test_wrong_values_are_refused_by_name(options, argument):
    with pytest.raises(ValueError, match=f"(?i)^{argument}"):
        VecEnv(**options)


def test_numbers_of_numpy_and_paths_are_taken(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(configuration("published"))
    env = VecEnv("passage", np.int64(3), threads=np.uint8(2), seed=np.int32(4), episode_s=np.float32(2.0), config=file, penalties=1)
    assert env.obs.shape == (3, 5, 6) and env.seed == 4 and env.episode_s == 2.0 and env.episode_steps == 40


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda a: a.astype(">f4"), "type"),
        (lambda a: a.astype(np.complex64), "type"),
        (lambda a: a.astype(bool), "type"),
        (lambda a: a.astype(str), "type"),
        (lambda a: np.concatenate([a, a])[::2], "contiguous"),
        (lambda a: a[:, ::-1], "contiguous"),
        (lambda a: unaligned(a), "aligned"),
        (lambda a: np.zeros((5, 2, 2), np.float32), "shape"),
        (lambda a: a.ravel(), "shape"),
        (lambda a: 3, "numpy"),
    ],
)
def test_arrays_that_lie_otherwise_are_refused_by_name(change, words):
    env = VecEnv("passage", 2, seed=1)
    before = env.state()
    given = change(np.zeros((2, 5, 2), np.float32))
    with pytest.raises(ValueError, match=f"^actions: .*{words}"):
        env.step(given)
    assert env.state() == before, "nothing has changed"


def unaligned(array):
    """The same array, a byte beside where its numbers belong."""
    room = np.zeros(array.nbytes + 1, np.uint8)
    room[1:] = array.view(np.uint8).ravel()
    beside = room[1:].view(array.dtype).reshape(array.shape)
    assert not beside.flags.aligned and beside.flags.c_contiguous
    return beside


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    "buffer, change, words",
    [
        ("obs", lambda a: a.resize((1, 5, 6), refcheck=False), "its shape is"),
        ("reward", lambda a: setattr(a, "shape", (10,)), "its shape is"),
        ("age", lambda a: setattr(a, "dtype", np.int32), "its type is"),
        ("last_obs", lambda a: a.setflags(write=False), "not writeable"),
        ("terminated", lambda a: setattr(a, "dtype", np.uint8), "its type is"),
    ],
)
def test_a_buffer_that_was_changed_from_outside_is_refused_by_name_and_nothing_changes(buffer, change, words):
    env = VecEnv("passage", 2, message="observations", seed=2)
    other = env.copy()
    change(getattr(env, buffer))
    for call in (lambda: env.step(np.zeros((2, 5, 2), np.float32)), env.reset, lambda: env.reset(seed=3), env.state):
        with pytest.raises(ValueError, match=f"^{buffer}: this buffer was changed from outside: .*{words}"):
            call()
    assert env.seed == 2 and other.seed == 2
    with pytest.raises(AttributeError):
        env.obs = other.obs


def test_a_step_that_is_refused_leaves_everything_as_it_was():
    env = VecEnv("passage", 2, message="action", message_size=2, conditions="late", seed=2)
    before = env.state()
    good, words = np.ones((2, 5, 2), np.float32), np.ones((2, 5, 2), np.float32)
    bad = words.copy()
    bad[1, 4, 1] = np.nan
    for actions, messages in ((good, bad), (bad, words), (good, None), (good, words.astype(np.float64))):
        with pytest.raises(ValueError):
            env.step(actions, *([] if messages is None else [messages]))
        assert env.state() == before
    for mask, seed in ((np.ones(2, np.int8), None), (np.ones(2, bool), 4), (None, -1)):
        with pytest.raises(ValueError):
            env.reset(mask, seed=seed)
        assert env.state() == before and env.seed == 2


def test_without_a_seed_it_is_drawn_and_can_be_given_again():
    one, other = VecEnv("passage", 2, seed=None), VecEnv("passage", 2, seed=None)
    assert one.seed != other.seed and not np.array_equal(one.obs, other.obs)
    assert np.array_equal(VecEnv("passage", 2, seed=one.seed).obs, one.obs)
    assert np.array_equal(VecEnv("passage", 2).obs, VecEnv("passage", 2, seed=0).obs), "its own default is 0"


@pytest.mark.parametrize("options", [
    {"num_envs": 2**20, "message": "action", "message_size": 1024},
    {"scenario": "flocking", "num_envs": 2**20, "num_robots": 100, "message": "observations"},
])  # fmt: skip
def test_more_environments_than_there_is_memory_for_are_a_memory_error(options):
    with pytest.raises(MemoryError, match=r"num_envs: 1048576 environments of \d+ robots need [\d.]+ GiB of memory"):
        VecEnv(**options)


def test_a_limit_of_the_process_is_a_memory_error_too_and_not_the_end_of_the_process():
    script = """
import murmurate, numpy as np, sys
made, kept = 0, []
for num_envs in (2**19, 2**18, 2**17, 2**16, 2**15, 2**14):
    try:
        kept.append(murmurate.VecEnv(num_envs=num_envs, message="observations", threads=8))
        made += 1
        kept[-1].step(np.zeros((num_envs, 5, 2), np.float32))
    except MemoryError as error:
        assert "GiB of memory" in str(error), error
for again in range(100):
    try:
        kept.append(kept[-1].copy())
        kept[-1].state()
    except MemoryError as error:
        print("made", made)
        sys.exit(0)
"""
    limit = lambda: resource.setrlimit(resource.RLIMIT_AS, (2 * 2**30, 2 * 2**30))
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, preexec_fn=limit, timeout=300)
    assert said.returncode == 0 and "made 0" not in said.stdout and "made" in said.stdout, said.stderr


def configuration(preset, *flags):
    said = subprocess.run(
        [sys.executable, "-P", "-m", "murmurate", "train", "passage", "--print-config", "--preset", preset, *flags],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return said.stdout


def test_a_configuration_decides_the_team_and_its_curriculum_is_taken_or_named(tmp_path):
    file = tmp_path / "seven.toml"
    file.write_text(configuration("robust", "--robots", "7"))
    with pytest.warns(UserWarning, match="seven.toml' has a curriculum whose groups, repeat, penalties are not taken: stage=0"):
        env = VecEnv(config=file)
    assert (env.num_robots, env.episode_s, env.hold_s, env.repeat) == (7, 15.0, 0.4, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert VecEnv(config=file, penalties=1).num_robots == 7
        assert VecEnv(config=file, num_robots=4, penalties=1).num_robots == 4, "an argument goes before"
        last = VecEnv(config=file, stage=-1, num_envs=64, seed=1)
        dearer = VecEnv(config=file, penalties=1.5, repeat=2, num_envs=64, seed=1)
    assert last.repeat == 2
    for env in (last, dearer):
        for _ in range(30):
            env.step(np.full((64, 7, 2), 0.9, np.float32))
    assert np.array_equal(last.reward, dearer.reward), "the last stage has 1.5 times the penalties, and holds actions twice"
    with pytest.raises(ValueError, match=r"stage: its groups \[\[3, 4\]\] are not the whole team of 7"):
        VecEnv(config=file, stage=0)
    with pytest.raises(ValueError, match=r"stage: its groups \[\[7\]\] are not the whole team of 5"):
        VecEnv(config=file, stage=1, num_robots=5)
    narrow = tmp_path / "narrow.toml"
    narrow.write_text(file.read_text().replace("penalties = 1.5", "penalties = 1.5\ngap_m = 0.8"))
    assert not np.array_equal(VecEnv(config=narrow, stage=-1).render(), VecEnv(config=narrow, stage=-2).render()), "its gap"


def test_penalties_have_their_factor():
    def worst(penalties):
        env = VecEnv("passage", 64, seed=2, penalties=penalties)
        sums = []
        for _ in range(40):
            where = env.obs[..., 2:4]
            env.step(np.clip(3 * (where.mean(axis=1, keepdims=True) - where), -0.9, 0.9).astype(np.float32))
            sums.append(env.reward.mean())
        return min(sums)

    assert worst(0.0) > worst(1.0) > worst(4.0)


def test_a_flock_is_rewarded_for_what_a_flock_is():
    env = VecEnv("flocking", 8, seed=1)
    assert env.num_robots == 50 and env.observation_fields == ["position", "velocity"]
    assert (env.episode_s, env.limit_m_s, env.radius_m, env.hold_s) == (10.0, 1.5, 2.0, pytest.approx(0.2))
    velocity = env.obs[..., 2:4].copy()
    for _ in range(3):
        env.step(np.ascontiguousarray(velocity))
        after = env.obs[..., 2:4]
        spread = ((after - after.mean(axis=1, keepdims=True)) ** 2).sum(axis=-1)
        assert np.allclose(env.reward, -spread, atol=1e-4), "nobody touches anybody"
    # Robots that take the mean velocity earn more.
    for _ in range(60):
        now = env.obs[..., 2:4]
        env.step(np.ascontiguousarray(now + np.clip(now.mean(axis=1, keepdims=True) - now, -0.05, 0.05)))
    assert env.reward.mean() > -0.05 > -spread.mean()
    assert not env.terminated.any() and not env.arrived.any()


def test_a_reward_of_goals_is_refused_where_there_are_none(tmp_path):
    for config in ("robust", "published"):
        with pytest.raises(ValueError, match="config: reward.scenario is 0, but robots of 'flocking' have no goals"):
            VecEnv("flocking", config=config)
    file = tmp_path / "own.toml"
    file.write_text(configuration("robust").replace("scenario = 0.0", "scenario = 2.0"))
    assert VecEnv("flocking", config=file, penalties=0).num_robots == 50
    imitation = tmp_path / "imitation.toml"
    imitation.write_text((pathlib.Path(__file__).parents[2] / "policies" / "flocking.toml").read_text())
    with pytest.raises(ValueError, match="config: .* is of a training by imitation"):
        VecEnv("flocking", config=imitation)


def test_a_picture_shows_walls_robots_and_goals():
    env = VecEnv("passage", 3, seed=1)
    picture = env.render()
    assert picture.dtype == np.uint8 and picture.ndim == 3 and picture.shape[2] == 3 and max(picture.shape) <= 401
    assert np.array_equal(picture, env.render(0)) and not np.array_equal(picture, env.render(2))
    colours = {tuple(colour) for colour in picture.reshape(-1, 3)}
    assert {(61, 70, 81), (0, 114, 178), (213, 94, 0), (0, 158, 115), (230, 159, 0), (204, 121, 167)} <= colours
    for _ in range(10):
        env.step(np.full((3, 5, 2), 0.5, np.float32))
    assert not np.array_equal(picture, env.render(0))
    for wrong in (-1, 3, "x"):
        with pytest.raises(ValueError, match="^environment: "):
            env.render(wrong)
    assert VecEnv("flocking", 1).render().shape[2] == 3 and murmurate.VecEnv("swap", num_robots=4).render().any()
