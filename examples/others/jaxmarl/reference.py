"""Compares the graph in this folder with a flax agent in JaxMARL's own environment, and measures the return of the team there.

    python reference.py WEIGHTS [EPISODES [FOLDER]]

needs numpy, onnxruntime, jax, flax, and jaxmarl from PyPI (0.2.0; its requirements can be left out: pip install --no-deps jaxmarl).
It also records steps of the environment under random actions, and of the agents, for the tests of this repository; all 1000 of
the agents go to FOLDER if that is given.
"""

import json
import pathlib
import sys

import jax
import jax.numpy as jnp
import numpy as np
import onnxruntime
from flax import linen as nn

from jaxmarl.environments.mpe.simple_spread import SimpleSpreadMPE
from make import HERE, ROBOTS, STATE, weights

STEPS = 25
ROOT = HERE.parents[2]


class Agent(nn.Module):
    """Agent of JaxMARL's baselines/QLearning: a dense layer, a GRU cell and a dense layer."""

    @nn.compact
    def __call__(self, state, x):
        x = nn.relu(nn.Dense(STATE, name="Dense_0")(x))
        state, x = nn.GRUCell(STATE, name="GRUCell_0")(state, x)
        return state, nn.Dense(5, name="Dense_1")(x)


def nested(tensors):
    """Returns weights as the nested dictionaries of flax."""
    tree = {}
    for name, value in tensors.items():
        *path, last = [part for part in name.split(",") if part != "ScannedRNN_0"]
        at = tree
        for part in path:
            at = at.setdefault(part, {})
        at[last] = value
    return {"params": tree}


def team(parameters, environment):
    """Returns a function that plays an episode and returns the return of the team, and all that was seen and done."""
    ids = jnp.eye(ROBOTS)

    def episode(key, keeps):
        observed, world = environment.reset(key)

        def step(carry, _):
            observed, world, state = carry
            seen = jnp.concatenate([jnp.stack([observed[name] for name in environment.agents]), ids], 1)
            after, values = Agent().apply(parameters, state * keeps, seen)
            actions = dict(zip(environment.agents, values.argmax(-1)))
            observed, world, rewards, _, _ = environment.step_env(key, world, actions)
            total = sum(rewards.values())
            return (observed, world, after), (total, seen, values, after)

        _, found = jax.lax.scan(step, (observed, world, jnp.zeros((ROBOTS, STATE))), None, length=STEPS)
        return found[0].sum(), found

    return jax.jit(episode)


def interval(values):
    """Returns the mean and half of its 95 % interval."""
    return np.mean(values), 1.96 * np.std(values, ddof=1) / len(values) ** 0.5


def inputs_of(seen):
    """Returns what the graph takes of a robot, from its observation in JaxMARL and its id."""
    row = [float(f"{value:.9g}") for value in np.float64(seen)]
    pairs = lambda values: [values[at : at + 2] for at in range(0, len(values), 2)]
    given = {"velocity": row[:2], "position": row[2:4], "landmarks": pairs(row[4:10]), "edges": pairs(row[10:14])}
    return given | {"heard": [1.0] * (ROBOTS - 1), "id": row[18:]}


def compared(play):
    """Compares graph and agent over 1000 steps, each with its own state, and returns the steps."""
    session = onnxruntime.InferenceSession(str(HERE / "spread.onnx"))
    worst, recorded, plain = 0.0, [], lambda values: [float(f"{value:.9g}") for value in np.float64(values)]
    for episode in range(40):
        _, (_, seen, values, after) = play(jax.random.PRNGKey(episode), 1.0)
        states = np.zeros((ROBOTS, 1, STATE), np.float32)
        for at in range(STEPS):
            robots = []
            for robot in range(ROBOTS):
                given = inputs_of(seen[at, robot])
                feed = {name: np.float32(value)[None] for name, value in given.items()} | {"state": states[robot]}
                action, states[robot] = session.run(["action", "state_next"], feed)
                apart = [np.abs(action[0] - values[at, robot]).max(), np.abs(states[robot][0] - after[at, robot]).max()]
                worst = max(worst, *apart)
                expected = {"action": plain(values[at, robot]), "state_next": plain(after[at, robot, :2])}
                robots.append({"given": given, "near": [], "expected": expected})
            recorded.append({"reset": at == 0, "robots": robots})
    print(f"graph and flax: {len(recorded)} steps of {ROBOTS} robots, at most {worst:.1e} apart")
    return recorded


def wandering(environment, episodes=8):
    """Returns episodes of the environment under random actions: positions, velocities, forces and rewards of each step."""
    found, plain = [], lambda array: [[float(f"{value:.9g}") for value in row] for row in np.float64(array)]
    for episode in range(episodes):
        key = jax.random.PRNGKey(1000 + episode)
        _, world = environment.reset(key)
        drawn = np.random.default_rng(episode)
        steps = [{"position": plain(world.p_pos[:ROBOTS]), "velocity": plain(world.p_vel[:ROBOTS])}]
        for _ in range(STEPS):
            actions = drawn.integers(0, 5, ROBOTS)
            _, world, rewards, _, _ = environment.step_env(key, world, dict(zip(environment.agents, jnp.array(actions))))
            row = {"actions": actions.tolist(), "reward": float(sum(rewards.values()))}
            steps.append(row | {"position": plain(world.p_pos[:ROBOTS]), "velocity": plain(world.p_vel[:ROBOTS])})
        found.append({"landmarks": plain(world.p_pos[ROBOTS:]), "steps": steps})
    return found


def main(path, episodes, whole):
    environment = SimpleSpreadMPE()
    play = team(nested(weights(path)), environment)
    steps = compared(play)
    write(ROOT / "tests/onnx/data/others/jaxmarl-spread.json", {"robots": ROBOTS, "steps": steps[:60]}, "steps")
    if whole:
        write(pathlib.Path(whole) / "jaxmarl-spread.json", {"robots": ROBOTS, "steps": steps}, "steps")
    write(ROOT / "tests/stranger/data/spread.json", {"episodes": wandering(environment)}, "episodes")
    keys = jax.random.split(jax.random.PRNGKey(7), episodes)
    for name, keeps in (("as trained", 1.0), ("state zeroed", 0.0)):
        returns = np.asarray(jax.vmap(lambda key: play(key, keeps)[0])(keys))
        mean, half = interval(returns)
        print(f"{name}: return of the team {mean:.2f} +- {half:.2f} (95 %) over {episodes} episodes of {STEPS} steps")


def write(path, found, field):
    """Writes a record with a line for each entry of its list ``field``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    head = "".join(f'"{name}": {json.dumps(value)}, ' for name, value in found.items() if name != field)
    lines = ",\n".join(json.dumps(one) for one in found[field])
    path.write_text(f'{{{head}"{field}": [\n{lines}\n]}}\n')


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 2000, sys.argv[3] if len(sys.argv) > 3 else None)
