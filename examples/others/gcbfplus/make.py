"""Makes the graphs of GCBF+ in this folder from the actors that its authors have published.

    python make.py CHECKOUT        needs numpy and onnx, and a checkout of https://github.com/MIT-REALM/gcbfplus

The graphs take and give metres and metres per second. What the authors compute outside of their network is in the graph, too: the
edges to the goal and to hits of the lidar, and the nominal controller, to which the network's output is added.
"""

import pathlib
import pickle
import sys

import numpy as np
import onnx
from onnx import TensorProto, helper

HERE = pathlib.Path(__file__).parent
#: Metres per unit of length of the authors: their robots have a radius of 0.05, ours of 0.2 m.
LENGTH_M = 4.0
#: Speed [m/s] that 1 of the authors' units of speed stands for.
SPEED_M_S = 1.0
#: Numbers of the authors' environments: radius of perception, range of the lidar that counts, rays, step, mass.
SEEN, RANGE, RAYS, STEP_S, MASS = 0.5, 0.4, 32, 0.03, 0.1
#: Kinds of nodes as one-hot codes: robots, goals, hits.
ROBOT, GOAL, HIT = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
FILES = {"single": "SingleIntegrator", "double": "DoubleIntegrator"}


class Reader(pickle.Unpickler):
    """Reads a pickle of arrays of jax; the callables that it names are these three, and others are refused."""

    def find_class(self, module, name):
        if name == "_reconstruct_array":
            return self.array
        if name == "_reconstruct" and module.startswith("numpy"):
            from numpy._core.multiarray import _reconstruct

            return _reconstruct
        if module == "numpy" and name in ("ndarray", "dtype"):
            return getattr(np, name)
        raise pickle.UnpicklingError(f"{module}.{name}")

    @staticmethod
    def array(function, args, state, _):
        made = function(*args)
        made.__setstate__(state)
        return np.asarray(made)


def flat(tree, prefix=""):
    """Returns the arrays of nested dictionaries, by names with dots."""
    found = {}
    for key, value in tree.items():
        found |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: np.float32(value)}
    return found


def weights(checkout, name):
    """Returns the weights of an actor by their names."""
    path = pathlib.Path(checkout) / "pretrained" / name / "gcbf+" / "models" / "1000" / "actor.pkl"
    with path.open("rb") as file:
        return {key.removeprefix("params."): value for key, value in flat(Reader(file).load()).items()}


def regulator(second):
    """Returns the gain of the authors' nominal controller, a discrete linear quadratic regulator, by Riccati's iteration."""
    if second:
        a, b, q = np.eye(4), np.zeros((4, 2)), 5 * np.eye(4)
        a[0, 2] = a[1, 3] = STEP_S
        b[2, 0] = b[3, 1] = STEP_S / MASS
    else:
        a, b, q = np.eye(2), STEP_S * np.eye(2), 2 * np.eye(2)
    x = q.copy()
    for _ in range(20000):
        gain = np.linalg.solve(b.T @ x @ b + np.eye(2), b.T @ x @ a)
        x, before = q + a.T @ x @ (a - b @ gain), x
        if np.abs(x - before).max() < 1e-13:
            break
    return gain


class Graph:
    """Nodes and constants of a graph that is being written."""

    def __init__(self, tensors):
        self.nodes, self.tensors, self.count = [], dict(tensors), 0

    def constant(self, value, kind=np.float32):
        name = f"c{len(self.tensors)}"
        self.tensors[name] = np.asarray(value, kind)
        return name

    def add(self, kind, *inputs, **attributes):
        """Adds an operator. Inputs are names, and numbers become constants; returns the name of its output."""
        given = [one if isinstance(one, str) else self.constant(one) for one in inputs]
        self.count += 1
        self.nodes.append(helper.make_node(kind, given, [f"t{self.count}"], **attributes))
        return f"t{self.count}"

    def axes(self, kind, value, axis, **attributes):
        return self.add(kind, value, self.constant([axis], np.int64), **attributes)

    def dense(self, name, x):
        return self.add("Add", self.add("MatMul", x, f"{name}.kernel"), f"{name}.bias")

    def perceptron(self, name, x):
        return self.dense(f"{name}.Dense_1", self.add("Relu", self.dense(f"{name}.Dense_0", x)))

    def typed(self, edges, kind):
        """Returns edges with the codes of the node at their other end and of the robot's own."""
        one = self.add("Slice", edges, self.constant([0], np.int64), self.constant([1], np.int64), self.constant([2], np.int64))
        ones = self.add("Add", self.add("Mul", one, [0.0]), [1.0])
        return self.add("Concat", edges, self.add("Mul", ones, [*kind, *ROBOT]), axis=2)


def edges_of(g, second, gain):
    """Returns all edges [R, 33 + K, d], the mask of those that count, and the nominal command, from the inputs."""
    goal = g.add("Mul", "goal", [1 / LENGTH_M])
    error, scale = goal, [LENGTH_M] * 2
    if second:
        own = g.add("Mul", "velocity", [1 / SPEED_M_S])
        back = g.add("Neg", own)
        error = g.add("Concat", goal, back, axis=1)
        scale += [SPEED_M_S] * 2
    # The error is clamped along each axis to the components of a vector of the length SEEN.
    norm = g.add("Sqrt", g.add("Add", g.axes("ReduceSum", g.add("Mul", error, error), 1, keepdims=1), [1e-12]))
    most = g.add("Abs", g.add("Mul", g.add("Div", error, norm), [SEEN]))
    clamped = g.add("Max", g.add("Min", error, most), g.add("Neg", most))
    nominal = g.add("Clip", g.add("MatMul", clamped, gain.T), g.constant(-1.0), g.constant(1.0))

    lidar = g.add("Mul", "lidar", [1 / LENGTH_M])
    seen = g.add("Cast", g.add("Less", lidar, [RANGE]), to=TensorProto.FLOAT)
    angles = np.linspace(-np.pi, np.pi - 2 * np.pi / RAYS, RAYS)
    rays = -np.stack([np.cos(angles), np.sin(angles)], 1)[None]
    hits = g.add("Mul", g.axes("Unsqueeze", lidar, 2), rays)
    if second:
        each = g.add("Mul", g.axes("Unsqueeze", own, 1), np.ones((1, RAYS, 1)))
        hits = g.add("Concat", hits, each, axis=2)
    hits = g.add("Mul", hits, g.axes("Unsqueeze", seen, 2))
    others = g.add("Mul", g.add("Mul", "edges", [1 / one for one in scale]), g.axes("Unsqueeze", "heard", 2))
    to_goal = g.axes("Unsqueeze", g.add("Neg", error), 1)
    edges = g.add("Concat", g.typed(others, ROBOT), g.typed(to_goal, GOAL), g.typed(hits, HIT), axis=1)
    one = g.add("Add", g.add("Mul", norm, [0.0]), [1.0])
    return edges, g.add("Concat", "heard", one, seen, axis=1), nominal


def graph(name, tensors):
    """Returns the graph of an actor."""
    second = name == "double"
    g, layer = Graph(tensors), "GNN_0.GNNLayer_0."
    edges, mask, nominal = edges_of(g, second, regulator(second))
    messages = g.dense(layer + "Dense_0", g.perceptron(layer + "msg", edges))
    score = g.axes("Squeeze", g.dense(layer + "Dense_1", g.perceptron(layer + "attn", messages)), 2)
    score = g.add("Add", score, g.add("Mul", g.add("Sub", mask, [1.0]), [1e9]))
    weight = g.axes("Unsqueeze", g.add("Softmax", score, axis=1), 2)
    heard = g.axes("ReduceSum", g.add("Mul", messages, weight), 1, keepdims=0)
    kind = g.add("Mul", g.add("Add", g.add("Mul", g.axes("ReduceSum", heard, 1, keepdims=1), [0.0]), [1.0]), ROBOT)
    x = g.dense(layer + "Dense_2", g.perceptron(layer + "update", g.add("Concat", kind, heard, axis=1)))
    x = g.add("Tanh", g.dense("OutputDense", g.perceptron("PolicyHead", x)))
    command = g.add("Clip", g.add("Add", nominal, g.add("Mul", x, [2.0])), g.constant(-1.0), g.constant(1.0))
    unit = SPEED_M_S**2 / LENGTH_M / MASS if second else SPEED_M_S
    g.nodes.append(helper.make_node("Mul", [command, g.constant([unit])], ["action"]))

    value = lambda key, *shape: helper.make_tensor_value_info(key, TensorProto.FLOAT, ["R", *shape])
    inputs = [value("goal", 2), *([value("velocity", 2)] if second else []), value("lidar", RAYS)]
    inputs += [value("edges", "K", 4 if second else 2), value("heard", "K")]
    constants = [onnx.numpy_helper.from_array(np.asarray(array), key) for key, array in g.tensors.items()]
    made = helper.make_graph(g.nodes, name, inputs, [value("action", 2)], constants)
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    onnx.checker.check_model(model, full_check=True)
    return model


if __name__ == "__main__":
    for short, long in FILES.items():
        (HERE / f"{short}.onnx").write_bytes(graph(short, weights(sys.argv[1], long)).SerializeToString())
