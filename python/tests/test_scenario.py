"""Tasks in Python: environments, simulations, faces and the contract test; and tasks with mistakes."""

import copy
import pickle

import numpy as np
import pytest
from needs import need

import murmurate
from murmurate import Scenario, VecEnv, check_scenario, sim


class Yard(Scenario):
    """Two rows of robots change sides of open ground, as the file of a task says."""

    about = "two rows change sides"
    robots = {"default": 4, "least": 2, "most": 6}
    half_extent_m = [2.5, 2.5]
    start = {"rect": [-2.3, -2.3, 2.3, -0.8]}
    goal = {"rect": [-2.3, 0.8, 2.3, 2.3]}
    rules = {"arrival_m": 0.25, "limit_s": 30.0}


class Drawn(Yard):
    """The same ground with places, rewards, ends and observations of its own."""

    start = goal = None
    _columns = np.array([-2.0, -1.2, -0.4, 0.4, 1.2, 2.0])

    def reset(self, rng, n):
        robots = self.num_robots
        start = np.stack((self._columns[rng.orders(6)[:, :robots]], rng.uniform(-2.0, -1.5, (n, robots))), axis=2)
        goal = np.stack((self._columns[rng.orders(6)[:, :robots]], rng.uniform(1.5, 2.0, (n, robots))), axis=2)
        return start, goal

    def observe(self, state):
        return np.stack((state.to_go_m, np.repeat(state.time_s[:, None], self.num_robots, axis=1)), axis=2)

    def reward(self, state):
        return 4.0 * state.progress_m - 1.0 * state.robot

    def done(self, state):
        return state.position[:, :, 1] > 1.0


ARRAYS = ("obs", "last_obs", "reward", "terminated", "truncated", "arrived", "observed", "last_observed", "heard", "said")


def contents(env):
    return {name: getattr(env, name).copy() for name in ARRAYS}


def rolled(env, steps=30):
    """Everything that the arrays hold in some steps, by actions that depend on the observations."""
    seen = []
    for step in range(steps):
        env.step(np.ascontiguousarray(np.clip(env.obs[:, :, :2], -0.9, 0.9)))
        if step % 11 == 7:
            env.reset(np.arange(env.num_envs) == 1)
        seen += [getattr(env, name).tobytes() for name in ARRAYS]
    return seen


def with_method(**methods):
    """The task with other methods."""
    return type("Mine", (Drawn,), methods)()


def test_a_task_without_methods_is_its_task_file(tmp_path):
    from murmurate._bound import bound

    file = tmp_path / "yard.toml"
    file.write_text(bound(Yard).text)
    one, other = (VecEnv(of, 3, conditions="late", message="observations") for of in (Yard, file))
    assert one.scenario == "yard" and one.num_robots == 4 and one.observed.shape == (3, 4, 0)
    assert rolled(one) == rolled(other)
    assert sim(Yard(), "orca", episodes=4).trace_hash == sim(file, "orca", episodes=4).trace_hash
    assert VecEnv.from_state(one.state(), Yard).scenario == "yard"


def test_methods_give_layouts_rewards_ends_and_observations():
    env = VecEnv(Drawn(), 5, num_robots=3, autoreset="disabled", seed=2)
    truth = env.truth()
    assert truth.position.shape == (5, 3, 2) and np.array_equal(truth.position, truth.start)
    assert np.all(truth.goal[:, :, 1] >= 1.5) and len(np.unique(truth.goal[:, :, 0])) > 3
    assert np.allclose(env.observed[:, :, 0], truth.to_go_m) and np.all(env.observed[:, :, 1] == 0)
    assert np.array_equal(env.observed, env.last_observed)
    up = np.zeros((5, 3, 2), np.float32)
    up[:, :, 1] = 1.0
    for step in range(1, 100):
        before = env.truth().to_go_m
        env.step(up)
        truth = env.truth()
        assert np.allclose(truth.progress_m, before - truth.to_go_m, atol=1e-6)
        assert np.allclose(env.reward, 4 * truth.progress_m - truth.robot, atol=1e-6)
        assert np.allclose(env.observed[:, :, 1], 0.05 * step)
        assert np.array_equal(env.terminated, (truth.position[:, :, 1] > 1.0).all(axis=1))
        if env.terminated.all():
            break
    assert env.terminated.all() and not env.truncated.any()


def test_the_next_episode_begins_in_the_step_in_which_one_ends():
    env = VecEnv(Drawn, 4, seed=1)
    up = np.zeros((4, 4, 2), np.float32)
    up[:, :, 1] = 1.0
    while not env.terminated.any():
        env.step(up)
    ended = env.terminated.copy()
    truth = env.truth()
    assert np.array_equal(truth.time_s == 0.0, ended) and np.array_equal(truth.position[ended], truth.start[ended])
    assert np.all(env.last_observed[ended][:, :, 1] > 0) and np.all(env.observed[ended][:, :, 1] == 0)
    assert np.array_equal(env.last_observed[~ended], env.observed[~ended])


@pytest.mark.parametrize("options", [{}, {"conditions": "late", "message": "observations", "repeat": 3}])
def test_environments_continue_to_the_bit(options):
    env = VecEnv(Drawn(), 4, episode_s=1.0, seed=3, **options)
    rolled(env, 13)
    state, before = env.state(), contents(env)
    others = [env.copy(), copy.deepcopy(env), pickle.loads(pickle.dumps(env)), VecEnv.from_state(state, Drawn())]
    others.append(VecEnv(Drawn(), 4, episode_s=1.0, seed=77, threads=2, **options))
    others[-1].set_state(state)
    expected = rolled(env)
    for at, other in enumerate(others):
        assert all(np.array_equal(getattr(other, name), before[name]) for name in ARRAYS), at
        assert rolled(other) == expected, at
    env.reset(seed=3)
    new = VecEnv(Drawn(), 4, episode_s=1.0, seed=3, **options)
    assert rolled(env) == rolled(new)


def test_an_environment_does_not_depend_on_how_many_there_are():
    many, few = (VecEnv(Drawn, n, conditions="late", seed=5, episode_s=2.0) for n in (7, 2))
    for _ in range(60):
        actions = np.clip(many.obs[:, :, :2], -1, 1)
        many.step(np.ascontiguousarray(actions))
        few.step(np.ascontiguousarray(actions[:2]))
        for name in ARRAYS[:8]:
            assert np.array_equal(getattr(many, name)[:2], getattr(few, name)), name


def test_a_state_of_another_task_is_refused():
    env, plain = VecEnv(Drawn, 2), VecEnv(Yard, 2)
    state = env.state()
    with pytest.raises(ValueError, match="state: it is of a task in Python; give the task"):
        VecEnv.from_state(state)
    with pytest.raises(ValueError, match="state: it is of a task in Python"):
        plain.set_state(state)
    with pytest.raises(ValueError, match="state: it is not of a task in Python"):
        env.set_state(plain.state())
    before = env.state()
    for at in range(0, len(state), len(state) // 50):
        with pytest.raises(ValueError, match="^state"):
            env.set_state(state[:at] + bytes([state[at] ^ 1]) + state[at + 1 :])
        with pytest.raises(ValueError, match="^state"):
            env.set_state(state[:at])
    assert env.state() == before


class Counting(Drawn):
    """Counts calls, in a list that copies share."""

    def __init__(self):
        self._calls = []

    def done(self, state):
        self._calls.append(state.time_s[0])
        return super().done(state)


def test_simulations_have_the_layouts_the_ends_and_the_returns():
    results = sim(Drawn(), "orca", episodes=6, seed=4)
    assert results.scenario == "drawn" and results.episodes == 6 and len(results.returns) == 6
    assert results.successes == 6 and results.mean_return == pytest.approx(sum(results.returns) / 6)
    # Episodes end beyond the middle of the ground, before the robots are at their goals.
    whole = sim(with_method(done=Yard.done), "orca", episodes=6, seed=4)
    assert results.makespan_median_s < whole.makespan_median_s
    # An episode has gone at least as far as from -1.5 to 1.
    assert all(sum_ > 4 * 2.4 for sum_ in results.returns)
    task = Counting()
    sim(task, "orca", episodes=1, seed=4)
    assert task._calls == sorted(task._calls) and task._calls[0] == pytest.approx(0.05), "one call a period"


def test_equal_seeds_give_equal_traces_on_any_number_of_jobs():
    runs = [sim(Drawn, "orca", mode="offboard", episodes=3, repeats=2, seed=9, jobs=jobs) for jobs in (1, 2)]
    assert runs[0].trace_hash == runs[1].trace_hash and runs[0].returns == runs[1].returns
    assert sim(Drawn, "orca", mode="offboard", episodes=3, repeats=2, seed=10).trace_hash != runs[0].trace_hash


def test_the_contract_holds():
    check_scenario(Yard, episodes=10)
    check_scenario(Drawn(), num_robots=3, episodes=10)


def attribute(**attributes):
    return type("Mine", (Yard,), attributes)


MISTAKES = {
    "an unknown attribute": (attribute(wall=[]), "Mine.wall: there is no such field or method; did you mean 'walls'?"),
    "a method of another name": (attribute(rewards=lambda self, state: 0), "Mine.rewards: there is no such field"),
    "a missing attribute": (type("Mine", (Scenario,), {"robots": 3}), "Mine.half_extent_m: it is missing"),
    "another type": (attribute(half_extent_m="large"), "Mine.half_extent_m: "),
    "no plain data": (attribute(walls=[{"rect": {1, 2}}]), "Mine.walls[0].rect: a set is none of number, text, list"),
    "a wrong value": (attribute(walls=[{"rect": [0, 0, -1, 1]}]), "Mine.walls[0].rect[0]: the smallest x comes first"),
    "not a number": (attribute(hull_m=float("nan")), "Mine.hull_m: "),
    "a taken name": (attribute(name="passage"), "Mine.name: 'passage' is a scenario of this program"),
    "no room": (attribute(start={"disc": [0.0, -2.0, 0.3]}), "Mine.start: it has room for"),
    "no method": (attribute(done=3), "Mine.done: a int is no method"),
    "no places": (attribute(start=None, goal=None), "Mine.start: it is missing"),
    "an exception at once": (attribute(__init__=lambda self: 1 / 0), "Mine.__init__: ZeroDivisionError"),
    "no scenario": (int, "scenario: the class int is no subclass of murmurate.Scenario"),
    "no name": (3.5, "scenario: 3.5 is neither a name, nor a file, nor a murmurate.Scenario"),
}


@pytest.mark.parametrize("kind", MISTAKES)
def test_a_wrong_attribute_is_one_line_with_class_and_attribute(kind):
    task, words = MISTAKES[kind]
    for made in (lambda: VecEnv(task, 2), lambda: sim(task, "orca", episodes=1), lambda: check_scenario(task)):
        with pytest.raises(ValueError) as raised:
            made()
        said = str(raised.value)
        assert said.startswith(words) and "\n" not in said, said


def overlapping(self, rng, n):
    start, goal = Drawn.reset(self, rng, n)
    start[-1, 1] = start[-1, 0]
    return start, goal


def nowhere(self, rng, n):
    start, goal = Drawn.reset(self, rng, n)
    return start, goal + 10.0


def there(self, rng, n):
    start, _ = Drawn.reset(self, rng, n)
    return start, start


RESETS = {
    "one array": (lambda self, rng, n: np.zeros((n, 4, 2)), "Mine.reset: it returned a ndarray; return (start, goal)"),
    "another shape": (lambda self, rng, n: (np.zeros((n, 4)), np.zeros((n, 4))), "Mine.reset: start: its shape is ["),
    "nan": (lambda self, rng, n: (np.full((n, 4, 2), np.nan),) * 2, "Mine.reset: start: the value at [0, 0, 0]"),
    "texts": (lambda self, rng, n: (np.full((n, 4, 2), "x"),) * 2, "Mine.reset: start: its type is <U1"),
    "overlapping": (overlapping, "Mine.reset: in row "),
    "outside": (nowhere, "Mine.reset: in row 0 of "),
    "there already": (there, "Mine.reset: in row 0 of "),
    "a row too many": (lambda self, rng, n: rng.random((n + 1, 4)), "Mine.reset: ValueError: size: its first axis is "),
    "an unknown draw": (lambda self, rng, n: rng.normal(), "Mine.reset: AttributeError: rng has no 'normal'; it has"),
}


@pytest.mark.parametrize("kind", RESETS)
def test_layouts_that_cannot_be_are_refused_by_environments_and_simulations(kind):
    method, words = RESETS[kind]
    for made in (lambda task: VecEnv(task, 3), lambda task: sim(task, "orca", episodes=2)):
        with pytest.raises((ValueError, RuntimeError)) as raised:
            made(with_method(reset=method))
        said = str(raised.value)
        assert said.startswith(words) and "\n" not in said, said


def later(good, bad):
    """A method that is good at the beginning, and bad once a second is over."""
    return lambda self, state: bad(self, state) if state.time_s.max() > 0.4 else good(self, state)


def zero(self, state):
    return 1 / 0


LATER = {
    "reward": {
        "its shape": (lambda self, state: np.zeros(3), "Mine.reward: its shape is [3] and not [3, 4] (N, R)"),
        "nan": (lambda self, state: np.log(-np.abs(state.to_go_m)), "Mine.reward: the value at [0, 0] (N, R) is nan"),
        "none": (lambda self, state: None, "Mine.reward: its type is object and not one of real numbers"),
        "raised": (zero, "Mine.reward: ZeroDivisionError: division by zero (test_scenario.py, line "),
        "written": (lambda self, state: state.to_go_m.__iadd__(1), "Mine.reward: ValueError: output array is read-only"),
    },
    "done": {
        "numbers": (lambda self, state: state.time_s, "Mine.done: its type is float32 and not bool"),
        "its shape": (lambda self, state: state.wall[0, 0], "Mine.done: its shape is []"),
        "raised": (zero, "Mine.done: ZeroDivisionError"),
    },
    "observe": {
        "its shape": (lambda self, state: state.to_go_m, "Mine.observe: its shape is [3, 4] and not [3, 4, K]"),
        "more floats": (lambda self, state: state.position.repeat(3, 2), "Mine.observe: its shape is [3, 4, 6] and not"),
        "raised": (zero, "Mine.observe: ZeroDivisionError"),
    },
}


@pytest.mark.parametrize("method, kind", [(method, kind) for method, kinds in LATER.items() for kind in kinds])
@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_method_that_fails_in_a_step_is_one_line_and_nothing_has_changed(method, kind):
    bad, words = LATER[method][kind]
    env = VecEnv(with_method(**{method: later(getattr(Drawn, method), bad)}), 3, conditions="late", message="observations")
    actions = np.full((3, 4, 2), 0.1, np.float32)
    with pytest.raises((ValueError, RuntimeError)) as raised:
        for _ in range(20):
            before, state = contents(env), env.state()
            env.step(actions)
    said = str(raised.value)
    assert said.startswith(words) and "\n" not in said, said
    assert env.state() == state and all(np.array_equal(getattr(env, name), before[name]) for name in ARRAYS)
    env.reset()
    env.step(actions)


def test_a_reset_that_fails_changes_nothing():
    class Once(Drawn):
        _calls = []

        def reset(self, rng, n):
            self._calls.append(n)
            if len(self._calls) > 1:
                raise KeyError("no more\nlayouts")
            return super().reset(rng, n)

    env = VecEnv(Once, 3, episode_s=0.2)
    before = contents(env)
    for reset in (lambda: env.reset(), lambda: env.reset(np.array([True, False, False])), lambda: env.reset(seed=5)):
        with pytest.raises(RuntimeError, match=r"^Once.reset: KeyError: .*line \d+\)$"):
            reset()
    assert env.seed == 0 and all(np.array_equal(getattr(env, name), before[name]) for name in ARRAYS)
    with pytest.raises(RuntimeError, match="^Once.reset: KeyError"):
        for _ in range(9):
            state = env.state()
            env.step(np.zeros((3, 4, 2), np.float32))
    assert env.state() == state and Once._calls == [3, 3, 1, 3, 3]


class Follower(murmurate.Policy):
    """Drives towards the goal while the task says that there is a way to go."""

    contract = {
        "name": "follower",
        "rate_hz": 20,
        "radius_m": 2.0,
        "hold_s": 0.2,
        "observation": {
            "goal": {"source": "goal-minus-position", "shape": [2], "unit": "m", "frame": "world"},
            "seen": {"source": "observed", "shape": [2], "unit": "1", "stale_after_s": 0.12},
        },
        "action": {"kind": "velocity", "unit": "m/s", "frame": "world", "limit": 1.0},
    }

    def __init__(self):
        super().__init__(self.contract)
        self.seen = []

    def step(self, inputs):
        goal, seen = inputs.observation["goal"], inputs.observation["seen"]
        self.seen.append((np.linalg.norm(goal, axis=1), seen.copy()))
        return murmurate.Outputs(action=np.clip(goal, -1, 1) * (seen[:, :1] > 0.1))


def test_a_policy_takes_what_a_task_observes_as_a_sense():
    policy = Follower()
    results = sim(Drawn(), policy, episodes=2, seed=3, robots=3)
    assert results.episodes == 2 and results.successes >= 1
    # Before the run the program tries the policy. On open ground the way to go is the distance to the goal.
    steps = policy.seen[-150:]
    assert all(len(distance) == 3 and np.allclose(seen[:, 0], distance, atol=1e-4) for distance, seen in steps)
    times = np.array([seen[0, 1] for _, seen in steps])
    assert np.sum(times == 0) >= 1 and np.allclose(np.diff(times)[np.diff(times) > 0], 0.05, atol=1e-5)
    assert sim(Drawn(), Follower(), episodes=2, seed=3, robots=3).trace_hash == results.trace_hash
    with pytest.raises(RuntimeError, match="^Mine.observe: ZeroDivisionError"):
        sim(with_method(observe=later(Drawn.observe, zero)), Follower(), episodes=2, seed=3, robots=3)


@pytest.mark.parametrize("method", ["reward", "done"])
def test_a_method_that_fails_ends_a_simulation_with_its_line(method):
    with pytest.raises(RuntimeError, match=rf"^Mine.{method}: ZeroDivisionError: division by zero \(test_scenario.py"):
        sim(with_method(**{method: zero}), "orca", episodes=3)


def test_what_a_task_in_python_cannot_do_is_refused_with_what_to_do(tmp_path):
    with pytest.raises(ValueError, match="^Drawn.done: a process of the program cannot call a method in Python"):
        murmurate.train(Drawn, out=tmp_path / "mine")
    with pytest.raises(ValueError, match="^Drawn.done: a process of the program cannot call a method in Python"):
        murmurate.study("range", scenario=Drawn)
    with pytest.raises(ValueError, match="^record: a record cannot hold the methods of Drawn"):
        sim(Drawn, "orca", record=tmp_path / "record")
    with pytest.raises(ValueError, match="scale"):
        VecEnv(Drawn, 2, scale=0.5)
    with pytest.raises(ValueError, match="--hull-m: the scenario 'drawn' draws its own places"):
        sim(Drawn, "orca", hull_m=0.1, episodes=1)
    with pytest.raises(ValueError, match="^num_robots: the scenario 'drawn' takes 2 to 6 robots, not 9"):
        VecEnv(Drawn, 2, num_robots=9)


BROKEN = {
    "no draw": (lambda self, rng, n: tuple(np.stack((np.tile(self._columns[:4], (n, 1)), np.full((n, 4), y)), 2) for y in (-1.5, 1.5)), "reset"),
    "other rows": (lambda self, state: state.to_go_m - state.to_go_m.mean(axis=0), "reward"),
    "chance": (lambda self, state: np.random.default_rng().random((*state.to_go_m.shape, 2)), "observe"),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_the_first_broken_promise_is_named(kind):
    method, name = BROKEN[kind]
    with pytest.raises(ValueError, match="^Mine") as raised:
        check_scenario(with_method(**{name: method, "robots": 4}))
    assert "\n" not in str(raised.value)
    words = {"no draw": "all seeds give equal tasks", "other rows": "depends on the others", "chance": "two calls with"}
    assert words[kind] in str(raised.value)


def test_a_task_that_scripted_navigation_does_not_solve_is_named():
    class Far(Yard):
        rules = {"arrival_m": 0.25, "limit_s": 1.0}

    with pytest.raises(ValueError, match=r"^Far.scripted_success: scripted navigation succeeds in 0.0% of 5 episodes"):
        check_scenario(Far, episodes=5)


def test_a_task_without_methods_is_studied():
    options = {"layouts": 1, "repeats": 1, "ranges_m": [1], "policy": "orca", "robots": 2}
    assert murmurate.study("range", scenario=Yard, **options).rows


def test_a_task_without_methods_trains(tmp_path):
    training = murmurate.train(Yard, out=tmp_path / "yard", steps=4000, threads=1)
    assert training.decisions >= 4000 and (tmp_path / "yard" / "task.toml").exists()


def test_pettingzoo_takes_a_task():
    need("pettingzoo")
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    from murmurate.pettingzoo import parallel_env

    env = parallel_env(Drawn)
    assert env.observation_space("robot_0").shape == (env.core.obs.shape[2] + 2,)
    parallel_api_test(env, num_cycles=100)
    parallel_seed_test(lambda: parallel_env(Drawn()))


def test_gymnasium_takes_a_task():
    need("gymnasium")
    from gymnasium.utils.env_checker import check_env

    from murmurate.gymnasium import TeamEnv, TeamVectorEnv

    check_env(TeamEnv(Drawn), skip_render_check=True)
    many = TeamVectorEnv(Drawn, 3)
    observed, _ = many.reset(seed=1)
    assert observed.shape == (3, 4 * (many.core.obs.shape[2] + 2))
    up = np.tile(np.array([0.0, 1.0], np.float32), (3, 4))
    for _ in range(80):
        _, _, terminated, _, infos = many.step(up)
        if terminated.any():
            break
    assert "final_obs" in infos


def test_torchrl_takes_a_task():
    need("torchrl")
    from torchrl.envs.utils import check_env_specs

    from murmurate.torchrl import Env

    env = Env(Drawn, 3)
    check_env_specs(env)
    assert env.rollout(5)["agents", "observed"].shape == (3, 5, 4, 2)


def test_benchmarl_takes_a_task():
    need("benchmarl")
    from murmurate.benchmarl import Task

    task = Task(Drawn)
    assert task.name == "drawn" and task.environment(2).observed.shape == (2, 4, 2)
    assert task.get_env_fun(2, True, 0, "cpu")().rollout(3)["agents", "observed"].shape == (2, 3, 4, 2)
