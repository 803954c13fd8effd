"""States, copies and pickles of environments: they continue to the bit. And what another thread may do meanwhile."""

import concurrent.futures
import copy
import gc
import multiprocessing
import pathlib
import pickle
import shutil
import threading
import weakref

import numpy as np
import pytest
from needs import need

from murmurate import VecEnv

BUFFERS = ("obs", "last_obs", "reward", "terminated", "truncated", "arrived", "heard", "age", "said")
KINDS = {
    "perfect": {},
    "late, with messages": {"conditions": "late", "message": "observations", "threads": 2},
    "filtered, with floats of policies": {"conditions": "late", "message": "action", "message_size": 3, "filtered": 1.0},
    "robust, held": {"conditions": "robust", "repeat": 3, "autoreset": "disabled"},
    "swap": {"scenario": "swap", "num_robots": 4, "conditions": "robust"},
    "flocking": {"scenario": "flocking", "num_robots": 20, "message": "observations"},
}


def made(kind, **options):
    options = {"num_envs": 5, "episode_s": 1.0, "seed": 3, **KINDS[kind], **options}
    return VecEnv(options.pop("scenario", "passage"), options.pop("num_envs"), **options)


def rolled(env, steps=30):
    """Everything that the buffers hold in some steps, by actions that depend on the observations."""
    seen = []
    for step in range(steps):
        actions = np.ascontiguousarray(np.clip(env.obs[:, :, :2], -0.9, 0.9))
        words = np.full((env.num_envs, env.num_robots, env.said.shape[3]), step, np.float32)
        env.step(actions, *([words] if env.message == "action" else []))
        if step % 11 == 7:
            env.reset(np.arange(env.num_envs) == 1)
        seen += [getattr(env, name).tobytes() for name in BUFFERS]
    return seen


@pytest.mark.parametrize("kind", KINDS)
def test_environments_continue_to_the_bit(kind):
    env = made(kind)
    rolled(env, 13)
    state, buffers = env.state(), {name: getattr(env, name).copy() for name in BUFFERS}
    others = [env.copy(), copy.copy(env), copy.deepcopy(env), pickle.loads(pickle.dumps(env)), VecEnv.from_state(state)]
    others.append(made(kind, seed=77, threads=3))
    rolled(others[-1], 4)
    obs = others[-1].obs
    others[-1].set_state(state)
    assert others[-1].obs is obs, "a state is written into the same arrays"
    expected = rolled(env)
    for at, other in enumerate(others):
        assert all(np.array_equal(getattr(other, name), buffers[name]) for name in BUFFERS), at
        assert other.seed == 3 and other.scenario == env.scenario and other.hold_s == env.hold_s
        assert rolled(other) == expected, at
    env.set_state(state)
    assert rolled(env) == expected and rolled(env) != expected


def test_a_search_goes_back_to_a_state_as_often_as_it_likes():
    env = VecEnv("passage", 1, conditions="late", message="observations", autoreset="disabled", seed=1)
    root = env.state()
    best = {}
    for way in range(8):
        env.set_state(root)
        action = np.full((1, 5, 2), 0.2 * way - 0.8, np.float32)
        for _ in range(10):
            env.step(action)
        best[way] = float(env.reward.sum())
    env.set_state(root)
    for _ in range(10):
        env.step(np.full((1, 5, 2), 0.2 * 3 - 0.8, np.float32))
    assert float(env.reward.sum()) == best[3] and len(set(best.values())) > 4


def test_a_state_that_is_not_of_such_environments_is_refused_by_name():
    env = made("late, with messages")
    state = env.state()
    rolled(env, 3)
    before = env.state()
    damaged = bytearray(state)
    damaged[len(state) // 2] ^= 4
    newer = bytearray(state)
    newer[16] = 7
    wrong = {
        b"nothing": "these bytes are no state",
        b"": "these bytes are no state",
        state[:-1]: "damaged",
        state[:400]: "damaged",
        bytes(damaged): "damaged",
        bytes(newer): "format 7",
        made("late, with messages", num_envs=6).state(): "'num_envs' is 6 there and 5 here",
        made("perfect").state(): "'(conditions|message)'",
        made("late, with messages", num_robots=6).state(): "'num_robots' is 6 there and 5 here",
        made("late, with messages", episode_s=2.0).state(): "'episode_s' is 2.0 there and 1.0 here",
    }
    for state, words in wrong.items():
        with pytest.raises(ValueError, match=f"^state: .*{words}"):
            env.set_state(state)
        assert env.state() == before, "nothing has changed"
    for given in (None, "text", [1]):
        with pytest.raises(ValueError, match="^state: "):
            env.set_state(given)
    with pytest.raises(ValueError, match="^state: .*damaged"):
        VecEnv.from_state(bytes(damaged))


def test_clouds_and_new_processes_take_an_environment_as_an_argument():
    cloudpickle = need("cloudpickle")
    env = made("late, with messages")
    rolled(env, 5)
    again = pickle.loads(cloudpickle.dumps(env))
    pool = concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))
    with pool:
        there = pool.submit(rolled, env, 10).result(timeout=120)
    assert there == rolled(again, 10) == rolled(env, 10)


def test_attributes_are_read_and_other_work_is_refused_while_a_thread_steps():
    env = VecEnv("passage", 4096, conditions="late", message="observations", seed=0)
    actions, seen, stop = np.zeros((4096, 5, 2), np.float32), [], threading.Event()

    def look():
        while not stop.is_set():
            seen.append((env.num_envs, env.limit_m_s, env.seed, env.obs.shape, env.heard.shape, repr(env)))
            for other in (lambda: env.step(actions), env.state, env.reset, env.copy, env.render):
                try:
                    other()
                except RuntimeError as error:
                    seen.append(str(error))

    threads = [threading.Thread(target=look) for _ in range(2)]
    for thread in threads:
        thread.start()
    refused = 0
    for _ in range(15):
        try:
            env.step(actions)
        except RuntimeError as error:
            refused += 1
            assert str(error).startswith("step: another thread")
    stop.set()
    for thread in threads:
        thread.join()
    words = [one for one in seen if isinstance(one, str)]
    assert (4096, env.limit_m_s, 0, (4096, 5, 6), (4096, 5, 5), repr(env)) in seen
    assert words and all("another thread is in a step, a reset or a state of this environment" in one for one in words)
    # Afterwards it is as usable as before.
    env.step(actions)


def test_environments_are_freed():
    need("pettingzoo")
    need("gymnasium")
    from murmurate.gymnasium import TeamEnv, TeamVectorEnv
    from murmurate.pettingzoo import parallel_env

    for make in (VecEnv, parallel_env, TeamEnv, TeamVectorEnv):
        env = make("passage", seed=1)
        if make is not VecEnv:
            env.reset()
        if make is parallel_env:
            for agent in env.possible_agents:
                assert env.action_space(agent) is env.action_space(agent)
                env.observation_space(agent).sample()
        seen = weakref.ref(env)
        del env
        gc.collect()
        assert seen() is None, make


def test_a_pickle_of_a_task_file_needs_no_file(tmp_path):
    file = tmp_path / "rooms.toml"
    shutil.copy(pathlib.Path(__file__).parents[2] / "examples/tasks/four-rooms.toml", file)
    env = VecEnv(file, 3, conditions="robust", seed=4)
    assert (env.scenario, env.num_robots) == ("four-rooms", 6)
    rolled(env, 5)
    kept = pickle.dumps(env)
    file.unlink()
    again = pickle.loads(kept)
    assert again.scenario == "four-rooms"
    assert rolled(env) == rolled(again)
    with pytest.raises(ValueError, match="scenario: cannot read the task file"):
        VecEnv(file)
