"""Writes policy files from Python, and what they are to answer: the fixtures of tests/python_export.rs.

    pip install numpy safetensors
    python export.py

The weights are noise. `export` is what docs/bring-your-policy.md shows.
"""

import hashlib
import json
from pathlib import Path

import numpy as np
from safetensors.numpy import save_file

FOLDER = Path(__file__).parent


def export(path, manifest, encoder, message, update, probe={}):
    networks = {"encoder": encoder, "message": message, "update": update}
    tensors = {
        f"{network}.{name}": np.ascontiguousarray(tensor, dtype=np.float32)
        for network, state in networks.items()
        for name, tensor in state.items()
    }
    tensors |= {f"probe.{name}": np.ascontiguousarray(rows, dtype=np.float32) for name, rows in probe.items()}
    data = b"".join(tensors[name].tobytes() for name in sorted(tensors))
    manifest = {**manifest, "sha256": hashlib.sha256(data).hexdigest()}
    save_file(tensors, path, metadata={"murmurate": json.dumps(manifest)})


FULL = {
    "format": 1,
    "scenario": "passage",
    "architecture": "full",
    "observation": ["goal-minus-position", "position", "position-plus-velocity"],
    "edge": ["age", "relative-position"],
    "activation": "relu",
    "aggregation": "sum",
    "encoder": [6, 8, 8],
    "message": [2 * 8 + 3, 8, 8],
    "update": [8 + 8, 8, 4],
    "distribution": "diagonal-normal",
    "draw": "sample",
    "log_std_max": 0.5,
    "radius_m": 2.0,
    "rate_hz": 20.0,
    "limit_m_s": 1.5,
    "hold_s": 0.2,
}

PUBLISHED = {
    **{field: value for field, value in FULL.items() if field not in ("edge", "log_std_max")},
    "architecture": "published",
    "message": [8, 8, 8],
    "update": [8, 8, 4],
}


def noise(rng, widths):
    """What `nn.Sequential(nn.Linear(...), nn.ReLU(), nn.Linear(...), ...).state_dict()` holds, with random numbers."""
    state = {}
    for depth, (inputs, outputs) in enumerate(zip(widths, widths[1:])):
        reach = 1.0 / np.sqrt(inputs)
        state[f"{2 * depth}.weight"] = rng.uniform(-reach, reach, (outputs, inputs)).astype(np.float32)
        state[f"{2 * depth}.bias"] = rng.uniform(-reach, reach, outputs).astype(np.float32)
    return state


def run(state, x):
    """The network of a state dict."""
    depths = len(state) // 2
    for depth in range(depths):
        x = state[f"{2 * depth}.weight"].astype(np.float64) @ x + state[f"{2 * depth}.bias"]
        if depth + 1 < depths:
            x = np.maximum(x, 0.0)
    return x


def answers(architecture, networks, position, velocity, goal, age_ms):
    """Latents and outputs of a team in which everyone hears everyone; `age_ms[i][j]` is of what i heard from j."""
    encoder, message, update = networks
    team = range(len(position))
    seen = np.concatenate([goal - position, position, position + velocity], axis=1)
    h = [run(encoder, seen[i]) for i in team]
    outputs = []
    for i in team:
        others = [j for j in team if j != i]
        if architecture == "published":
            heard = sum(run(message, h[j] - h[i]) for j in [i, *others])
        else:
            edge = {j: [age_ms[i][j] / 1000.0, *(position[j] - position[i])] for j in others}
            terms = [run(message, np.concatenate([h[i], h[j], edge[j]])) for j in others]
            heard = np.concatenate([h[i], sum(terms, np.zeros(8))])
        outputs.append(run(update, heard))
    return h, outputs


def main():
    rng = np.random.default_rng(7)
    expected = {}
    for manifest in (PUBLISHED, FULL):
        name = manifest["architecture"]
        networks = [noise(rng, manifest[network]) for network in ("encoder", "message", "update")]
        expected[name] = []
        for robots in (1, 2, 5):
            # Rounded, so that the same numbers in 32 bits are as near as need be.
            position, velocity, goal = rng.uniform(-1.5, 1.5, (3, robots, 2)).round(3)
            age_ms = rng.integers(0, 200, (robots, robots)).tolist()
            h, outputs = answers(name, networks, position, velocity, goal, age_ms)
            case = {"position": position, "velocity": velocity, "goal": goal, "latent": h, "output": outputs}
            case = {key: np.round(value, 7).tolist() for key, value in case.items()}
            expected[name].append({**case, "age_ms": age_ms})
        # The last team is stored in the file, too: whoever loads it compares.
        fields = ("position", "velocity", "goal", "latent", "output")
        probe = {field: np.array(case[field]) for field in fields} | {"age": np.array(age_ms) / 1000.0}
        export(FOLDER / f"python_{name}.safetensors", manifest, *networks, probe)
    (FOLDER / "python_expected.json").write_text(json.dumps(expected) + "\n")


if __name__ == "__main__":
    main()
