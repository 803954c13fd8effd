"""Compares the graphs in this folder with the authors' own environment and actor, over 1000 steps of robots among obstacles.

    python reference.py CHECKOUT [FOLDER]

needs numpy, onnxruntime, jax, flax, jraph, optax, einops, scipy, jaxtyping, matplotlib, tqdm, and a checkout of
https://github.com/MIT-REALM/gcbfplus. It also writes 60 of the steps for the tests of this repository, and all 1000, of one robot
each, to FOLDER if that is given.
"""

import json
import pathlib
import sys
from unittest import mock

import numpy as np
import onnxruntime

from make import FILES, LENGTH_M, MASS, SPEED_M_S, HERE, weights

#: Packages that the authors' code imports, and that what is used of it does not need.
UNUSED = ["colour", "control", "cv2", "jaxproxqp", "jaxproxqp.jaxproxqp", "seaborn", "wandb"]
UNUSED += ["tensorflow_probability", "tensorflow_probability.substrates", "tensorflow_probability.substrates.jax"]
ROBOTS, EPISODES, STEPS = 16, 8, 125
#: Robots whose answers are compared: of robots 0 and 1 the authors' environments cut the edge to the goal to a length of 0.5, and of
#: all others they do not, since ``agent_goal_feats[:, :2]`` takes the first two goals and not the first two coordinates.
COMPARED = range(2, ROBOTS)
DATA = HERE.parents[2] / "tests" / "onnx" / "data" / "others"


def nested(tensors):
    """Returns weights as the nested dictionaries of flax."""
    tree = {}
    for name, value in tensors.items():
        *path, last = name.split(".")
        at = tree
        for part in path:
            at = at.setdefault(part, {})
        at[last] = value
    return {"params": tree}


def rows(state, graph):
    """Returns what each robot of a state observes and hears, in metres and in the order of a graph's inputs."""
    agents, goals = np.float64(state.agent), np.float64(state.goal)
    hits = np.float64(graph.states[2 * ROBOTS : 2 * ROBOTS + 32 * ROBOTS, :2]).reshape(ROBOTS, 32, 2)
    hits -= agents[:, None, :2]
    # Their lidar gives the hits from the nearest on; a graph takes them by the angles of the rays.
    order = np.argsort(np.round((np.arctan2(hits[..., 1], hits[..., 0]) + np.pi) * 16 / np.pi) % 32, axis=1)
    lidar = np.take_along_axis(np.linalg.norm(hits, axis=-1), order, 1) * LENGTH_M
    for robot in COMPARED:
        edges = agents[robot] - agents
        near = np.flatnonzero(np.hypot(edges[:, 0], edges[:, 1]) < 0.5)
        edges = edges[near[near != robot]]
        edges[:, :2] *= LENGTH_M
        edges[:, 2:] *= SPEED_M_S
        own = {"goal": (goals - agents)[robot, :2] * LENGTH_M, "velocity": agents[robot, 2:] * SPEED_M_S, "lidar": lidar[robot]}
        yield {name: np.float32(value) for name, value in own.items() if len(value)}, np.float32(edges)


def answer(session, own, edges):
    """Returns the action of a graph for one robot, with as many places as there are neighbours, or an empty one."""
    floats = edges.shape[1]
    feed = {name: value[None] for name, value in own.items()}
    feed["edges"] = edges[None] if len(edges) else np.zeros((1, 1, floats), np.float32)
    feed["heard"] = np.ones((1, len(edges)), np.float32) if len(edges) else np.zeros((1, 1), np.float32)
    return session.run(None, feed)[0][0]


def step(own, edges, action):
    """Returns a step of one robot, as the tests of this repository read it."""
    plain = lambda values: np.vectorize(lambda value: float(f"{value:.9g}"))(np.float64(values)).tolist()
    given = {name: plain(value) for name, value in own.items()}
    given["edges"] = plain(edges) if len(edges) else [[0.0] * edges.shape[1]]
    given["heard"] = [1.0] * len(edges) or [0.0]
    return {"reset": False, "robots": [{"given": given, "near": [], "expected": {"action": plain(action)}}]}


def main(checkout, whole):
    sys.path.insert(0, checkout)
    sys.modules.update({name: mock.MagicMock() for name in UNUSED})
    import jax
    from gcbfplus.algo.module.policy import DeterministicPolicy
    from gcbfplus.env import ENV

    for short, name in FILES.items():
        environment = ENV[name](num_agents=ROBOTS, area_size=4.0, max_step=256)
        policy = DeterministicPolicy(environment.node_dim, environment.edge_dim, ROBOTS, environment.action_dim)
        parameters = nested(weights(checkout, name))
        act = jax.jit(lambda graph: environment.clip_action(2 * policy.get_action(parameters, graph) + environment.u_ref(graph)))
        move = jax.jit(lambda graph, action: environment.step(graph, action)[0])
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        session = onnxruntime.InferenceSession(str(HERE / f"{short}.onnx"), options)
        unit = SPEED_M_S**2 / LENGTH_M / MASS if short == "double" else SPEED_M_S
        worst, steps, counts = 0.0, [], []
        for episode in range(EPISODES):
            graph = environment.reset(jax.random.PRNGKey(episode))
            for at in range(STEPS):
                wanted = act(graph)
                for robot, (own, edges) in zip(COMPARED, rows(graph.env_states, graph)):
                    worst = max(worst, np.abs(answer(session, own, edges) - np.float64(wanted[robot]) * unit).max())
                    counts.append(len(edges))
                    if robot == COMPARED[(at + episode) % len(COMPARED)]:
                        steps.append(step(own, edges, np.float64(wanted[robot]) * unit))
                graph = move(graph, wanted)
        print(f"{name}: {EPISODES * STEPS} steps of {len(COMPARED)} robots, 0 to {max(counts)} neighbours, at most {worst:.1e} apart")
        write(DATA / f"gcbfplus-{short}.json", steps[:: len(steps) // 60][:60])
        if whole:
            write(pathlib.Path(whole) / f"gcbfplus-{short}.json", steps)


def write(path, steps):
    path.parent.mkdir(exist_ok=True)
    lines = ",\n".join(json.dumps(one) for one in steps)
    path.write_text(f'{{"robots": 1, "steps": [\n{lines}\n]}}\n')


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else None)
