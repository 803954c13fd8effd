"""Writes a policy file of format 2 with a memory, and what a computation in numpy answers over several steps.

    pip install numpy safetensors
    python export_memory.py

They are the fixtures of tests/learning/memory.rs. The weights are noise. The cell is computed from the equations of
PyTorch's GRUCell. Written with numpy 2.4.6.
"""

import hashlib
import json
from pathlib import Path

import numpy as np
from safetensors.numpy import save_file

FOLDER = Path(__file__).parent
ROBOTS, STEPS = 3, 6
ENCODED, MEMORY, MESSAGE, HIDDEN = 5, 6, 4, 7
FIRST = {"inputs": ["own", "sender", "edge"], "widths": [2 * MEMORY + 3, MESSAGE], "output_activation": "tanh"}
SECOND = {"inputs": ["sender"], "widths": [HIDDEN, MESSAGE]}

MANIFEST = {
    "format": 2,
    "scenario": "passage",
    "observation": [
        "velocity",
        {"name": "turned", "source": "heading", "shape": [1], "unit": "rad", "frame": "policy"},
        "goal-minus-position",
    ],
    "edge": ["age", "relative-position"],
    "encoder": {"widths": [5, ENCODED], "output_activation": "relu"},
    "memory": {"cell": "gru", "floats": MEMORY, "after_gap_s": 0.3},
    "hops": [
        {"message": FIRST, "aggregation": "sum", "update": {"inputs": ["own", "messages"], "widths": [10, HIDDEN]}},
        {"message": SECOND, "aggregation": "max"},
    ],
    "decoder": {"widths": [MESSAGE, 4]},
    "distribution": "diagonal-normal",
    "draw": "mean",
    "radius_m": 2.0,
    "rate_hz": 20.0,
    "limit_m_s": 1.5,
    "hold_s": 0.2,
}


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def gru(weights, x, h):
    """The equations of PyTorch's GRUCell, for one row."""
    of_input = weights["memory.input.weight"] @ x + weights["memory.input.bias"]
    of_state = weights["memory.state.weight"] @ h + weights["memory.state.bias"]
    (ri, zi, ni), (rh, zh, nh) = np.split(of_input, 3), np.split(of_state, 3)
    r, z = sigmoid(ri + rh), sigmoid(zi + zh)
    return (1 - z) * np.tanh(ni + r * nh) + z * h


def linear(weights, name, x):
    return weights[f"{name}.weight"] @ x + weights[f"{name}.bias"]


def step(weights, given, states):
    """Latents, outputs and states of a team whose robots all hear each other."""
    names = ("position", "velocity", "goal", "heading", "age")
    position, velocity, goal, heading, age = (given[name] for name in names)
    observation = np.concatenate([velocity, heading, goal - position], axis=1)
    encoded = [np.maximum(linear(weights, "encoder.0", x), 0) for x in observation]
    states = np.array([gru(weights, x, h) for x, h in zip(encoded, states)])

    def first(i):
        total = np.zeros(MESSAGE)
        for j in range(ROBOTS):
            if j != i:
                row = np.concatenate([states[i], states[j], [age[i, j]], position[j] - position[i]])
                total += np.tanh(linear(weights, "hops.0.message.0", row))
        return linear(weights, "hops.0.update.0", np.concatenate([states[i], total]))

    second = np.array([first(i) for i in range(ROBOTS)])

    def outputs(i):
        heard = [linear(weights, "hops.1.message.0", second[j]) for j in range(ROBOTS) if j != i]
        return linear(weights, "decoder.0", np.max(heard, axis=0))

    answer = np.array([outputs(i) for i in range(ROBOTS)])
    return observation, np.concatenate([states, second], axis=1), answer, states


def main():
    rng = np.random.default_rng(7)
    shapes = {
        "encoder.0": (ENCODED, 5),
        "memory.input": (3 * MEMORY, ENCODED),
        "memory.state": (3 * MEMORY, MEMORY),
        "hops.0.message.0": (MESSAGE, 2 * MEMORY + 3),
        "hops.0.update.0": (HIDDEN, MEMORY + MESSAGE),
        "hops.1.message.0": (MESSAGE, HIDDEN),
        "decoder.0": (4, MESSAGE),
    }
    weights = {}
    for name, (rows, columns) in shapes.items():
        weights[f"{name}.weight"] = rng.normal(0, 0.8, (rows, columns)).astype(np.float32)
        weights[f"{name}.bias"] = rng.normal(0, 0.5, rows).astype(np.float32)
    exact = {name: tensor.astype(np.float64) for name, tensor in weights.items()}
    states, steps, probe = np.zeros((ROBOTS, MEMORY)), [], {}
    for at in range(STEPS):
        given = {name: rng.normal(0, 1, (ROBOTS, 2)).astype(np.float32) for name in ("position", "velocity", "goal")}
        given["heading"] = rng.uniform(-3, 3, (ROBOTS, 1)).astype(np.float32)
        given["age"] = np.full((ROBOTS, ROBOTS), 0.05, dtype=np.float32)
        before = states
        observation, latent, answer, states = step(exact, given, states)
        steps.append({name: values.tolist() for name, values in given.items() if name != "age"})
        steps[-1] |= {"latent": latent.tolist(), "output": answer.tolist()}
        if at == STEPS - 1:
            heading = given.pop("heading")
            heard = np.ones((ROBOTS, ROBOTS))
            probe = given | {"observation": observation, "memory": before, "latent": latent, "output": answer}
            probe["heard"] = heard
            assert np.allclose(observation[:, 2:3], heading)
    tensors = weights | {f"probe.{name}": np.ascontiguousarray(rows, np.float32) for name, rows in probe.items()}
    data = b"".join(tensors[name].tobytes() for name in sorted(tensors))
    manifest = MANIFEST | {"sha256": hashlib.sha256(data).hexdigest()}
    save_file(tensors, FOLDER / "memory.safetensors", metadata={"murmurate": json.dumps(manifest)})
    (FOLDER / "memory_expected.json").write_text(json.dumps(steps) + "\n")


main()
