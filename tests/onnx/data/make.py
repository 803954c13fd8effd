"""Makes the policies of format 3 in this folder, and what they answer by a computation of their own in numpy.

    python make.py        needs numpy and onnx

Weights are random, but for `field`, a potential field that reaches its goal.
"""
import json
import pathlib

import numpy as np
import onnx
from onnx import TensorProto, helper

HERE = pathlib.Path(__file__).parent
F = TensorProto.FLOAT
RNG = np.random.default_rng(7)


def weights(*shape):
    return (RNG.normal(0, 0.4, shape)).astype(np.float32)


def value(name, *shape):
    return helper.make_tensor_value_info(name, F, list(shape))


def model(name, nodes, inputs, outputs, tensors):
    constants = [onnx.numpy_helper.from_array(np.asarray(array), key) for key, array in tensors.items()]
    graph = helper.make_graph(nodes, name, inputs, outputs, constants)
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    onnx.checker.check_model(made)
    return made


def node(kind, inputs, output, **attributes):
    return helper.make_node(kind, inputs, [output], **attributes)


def save(made, name):
    (HERE / f"{name}.onnx").write_bytes(made.SerializeToString())


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


# A recurrent policy with attention: a GRU cell over the observation and what was heard.
M, S, E, O = 6, 12, 5, 4
W = {
    "key": weights(M + E, 8), "query": weights(S, 8), "value": weights(M + E, 8),
    "in": weights(O + 8, 3 * S), "hidden": weights(S, 3 * S), "bias": weights(3 * S),
    "say": weights(S, M), "move": weights(S, 2),
}


def recurrent_nodes():
    return [
        node("Concat", ["messages", "edges"], "heard_all", axis=2),
        node("MatMul", ["heard_all", "key"], "keys"),
        node("MatMul", ["heard_all", "value"], "values"),
        node("MatMul", ["state", "query"], "q"),
        node("Unsqueeze", ["q", "one"], "q1"),
        node("Mul", ["keys", "q1"], "kq"),
        node("ReduceSum", ["kq", "two"], "score", keepdims=0),
        node("Tanh", ["score"], "bounded"),
        node("Exp", ["bounded"], "e"),
        node("Mul", ["e", "heard"], "w"),
        node("ReduceSum", ["w", "one"], "sum", keepdims=1),
        node("Add", ["sum", "little"], "some"),
        node("Div", ["w", "some"], "share"),
        node("Unsqueeze", ["share", "two"], "share1"),
        node("Mul", ["values", "share1"], "weighted"),
        node("ReduceSum", ["weighted", "one"], "sensed", keepdims=0),
        node("Concat", ["goal", "velocity", "sensed"], "x", axis=1),
        node("MatMul", ["x", "in"], "xi"),
        node("Add", ["xi", "bias"], "xb"),
        node("MatMul", ["state", "hidden"], "hh"),
        helper.make_node("Split", ["xb", "sizes"], ["xr", "xz", "xn"], axis=1),
        helper.make_node("Split", ["hh", "sizes"], ["hr", "hz", "hn"], axis=1),
        node("Add", ["xr", "hr"], "r0"), node("Sigmoid", ["r0"], "r"),
        node("Add", ["xz", "hz"], "z0"), node("Sigmoid", ["z0"], "z"),
        node("Mul", ["r", "hn"], "rn"), node("Add", ["xn", "rn"], "n0"), node("Tanh", ["n0"], "n"),
        node("Sub", ["state", "n"], "d"), node("Mul", ["z", "d"], "zd"), node("Add", ["n", "zd"], "state_next"),
        node("MatMul", ["state_next", "say"], "m0"), node("Tanh", ["m0"], "message"),
        node("MatMul", ["state_next", "move"], "a0"), node("Tanh", ["a0"], "action"),
    ]


def recurrent_step(goal, velocity, messages, edges, heard, state):
    """The same in numpy, for one robot: messages [K, M], edges [K, E], heard [K]."""
    both = np.concatenate([messages, edges], 1)
    w = np.exp(np.tanh(((both @ W["key"]) * (state @ W["query"])).sum(1))) * heard
    sensed = ((both @ W["value"]) * (w / (w.sum() + 1e-6))[:, None]).sum(0)
    x = np.concatenate([goal, velocity, sensed]) @ W["in"] + W["bias"]
    h = state @ W["hidden"]
    r, z = sigmoid(x[:S] + h[:S]), sigmoid(x[S:2 * S] + h[S:2 * S])
    n = np.tanh(x[2 * S:] + r * h[2 * S:])
    state = n + z * (state - n)
    return np.tanh(state @ W["move"]), np.tanh(state @ W["say"]), state


def recurrent():
    inputs = [value("goal", "R", 2), value("velocity", "R", 2), value("messages", "R", "K", M),
              value("edges", "R", "K", E), value("heard", "R", "K"), value("state", "R", S)]
    outputs = [value("action", "R", 2), value("message", "R", M), value("state_next", "R", S)]
    tensors = {**W, "one": np.array([1]), "two": np.array([2]), "sizes": np.array([S, S, S]),
               "little": np.array([1e-6], np.float32)}
    save(model("recurrent", recurrent_nodes(), inputs, outputs, tensors), "recurrent")
    rng, state, steps = np.random.default_rng(3), np.zeros(S), []
    for at in range(60):
        if at == 30:
            state = np.zeros(S)  # a new episode
        own, goal = rng.normal(0, 1, 4), rng.normal(0, 1, 2)
        count = [0, 1, 3, 6][at % 4]
        others = [{"motion": rng.normal(0, 1, 4), "age": float(rng.uniform(0, 0.2)), "message": np.tanh(rng.normal(0, 1, M))}
                  for _ in range(count)]
        nearest = sorted(range(count), key=lambda k: np.hypot(*(others[k]["motion"][:2] - own[:2])))[:4]
        used = [others[k] for k in sorted(nearest)]
        edge = lambda o: np.concatenate([own[:2] - o["motion"][:2], own[2:] - o["motion"][2:], [o["age"]]])
        messages = np.array([o["message"] for o in used]) if used else np.zeros((1, M))
        edges = np.array([edge(o) for o in used]) if used else np.zeros((1, E))
        heard = np.ones(len(used)) if used else np.zeros(1)
        action, message, state = recurrent_step(goal - own[:2], own[2:], messages, edges, heard, state)
        plain = lambda a: [float(np.float32(v)) for v in a]
        steps.append({"own": plain(own), "goal": plain(goal), "reset": at == 30, "action": plain(action), "message": plain(message),
                      "others": [{"motion": plain(o["motion"]), "age": o["age"], "message": plain(o["message"])} for o in others]})
    (HERE / "recurrent.json").write_text(json.dumps(steps))


def field():
    """A potential field as two graphs: each robot says where it goes, and keeps away from where others go."""
    say = [node("Mul", ["goal", "near"], "wish"), node("Clip", ["wish", "low", "high"], "message")]
    tensors = {"near": np.array([1.5], np.float32), "low": np.array(-1, np.float32), "high": np.array(1, np.float32)}
    save(model("say", say, [value("goal", "R", 2)], [value("message", "R", 2)], tensors), "field-say")
    # Repulsion: (own - theirs) / distance^3, turned a little to the left so that two do not block each other.
    act = [
        node("Mul", ["edges", "edges"], "sq"), node("ReduceSum", ["sq", "two"], "d2", keepdims=1),
        node("Add", ["d2", "little"], "d2s"), node("Pow", ["d2s", "power"], "d4"),
        node("Div", ["edges", "d4"], "push"), node("MatMul", ["push", "turn"], "turned"),
        node("Unsqueeze", ["heard", "two"], "h"), node("Mul", ["turned", "h"], "heard_push"),
        node("ReduceSum", ["heard_push", "one"], "total", keepdims=0), node("Mul", ["total", "gain"], "away"),
        node("Add", ["own_message", "away"], "sum"), node("Clip", ["sum", "low", "high"], "action"),
    ]
    tensors = {"two": np.array([2]), "one": np.array([1]), "little": np.array([1e-3], np.float32),
               "power": np.array([1.5], np.float32), "gain": np.array([0.12], np.float32),
               "turn": np.array([[0.8, 0.6], [-0.6, 0.8]], np.float32),
               "low": np.array(-1, np.float32), "high": np.array(1, np.float32)}
    inputs = [value("own_message", "R", 2), value("edges", "R", "K", 2), value("heard", "R", "K")]
    save(model("act", act, inputs, [value("action", "R", 2)], tensors), "field-act")


def silent():
    """A policy without a message: what is heard of a neighbour is where it is."""
    nodes = [node("Tanh", ["goal"], "wish"), node("Unsqueeze", ["heard", "two"], "h"), node("Mul", ["edges", "h"], "there"),
             node("ReduceSum", ["there", "one"], "sum", keepdims=0), node("Mul", ["sum", "gain"], "away"),
             node("Add", ["wish", "away"], "action")]
    tensors = {"two": np.array([2]), "one": np.array([1]), "gain": np.array([0.1], np.float32)}
    inputs = [value("goal", "R", 2), value("edges", "R", "K", 2), value("heard", "R", "K")]
    save(model("silent", nodes, inputs, [value("action", "R", 2)], tensors), "silent")


def wide():
    """The potential field with messages of 1500 floats, in which a neighbour reads where a robot wants to go."""
    floats = 1500
    spread = np.random.default_rng(5).normal(0, 1, (2, floats)).astype(np.float32)
    say = [node("Clip", ["goal", "low", "high"], "wish"), node("MatMul", ["wish", "spread"], "message")]
    tensors = {"low": np.array(-1, np.float32), "high": np.array(1, np.float32)}
    save(model("say", say, [value("goal", "R", 2)], [value("message", "R", floats)], {**tensors, "spread": spread}), "wide-say")
    act = [
        node("Mul", ["edges", "edges"], "sq"), node("ReduceSum", ["sq", "two"], "d2", keepdims=1),
        node("Add", ["d2", "little"], "d2s"), node("Pow", ["d2s", "power"], "d4"),
        node("Div", ["edges", "d4"], "push"), node("MatMul", ["push", "turn"], "turned"),
        node("MatMul", ["messages", "gather"], "wishes"), node("Sub", ["turned", "wishes"], "both"),
        node("Unsqueeze", ["heard", "two"], "h"), node("Mul", ["both", "h"], "heard_push"),
        node("ReduceSum", ["heard_push", "one"], "total", keepdims=0), node("Mul", ["total", "gain"], "away"),
        node("MatMul", ["own_message", "gather"], "own"), node("Add", ["own", "away"], "sum"),
        node("Clip", ["sum", "low", "high"], "action"),
    ]
    tensors = {**tensors, "two": np.array([2]), "one": np.array([1]), "little": np.array([1e-3], np.float32),
               "power": np.array([1.5], np.float32), "gain": np.array([0.12], np.float32),
               "turn": np.array([[0.8, 0.6], [-0.6, 0.8]], np.float32), "gather": np.linalg.pinv(spread).astype(np.float32)}
    inputs = [value("own_message", "R", floats), value("messages", "R", "K", floats), value("edges", "R", "K", 2),
              value("heard", "R", "K")]
    save(model("act", act, inputs, [value("action", "R", 2)], tensors), "wide-act")


def lidar():
    """Towards the goal, and away from what the lidar sees: 32 rays from -x of the world, without a message."""
    angles = -np.pi + np.arange(32) * np.pi / 16
    nodes = [node("Clip", ["goal", "low", "high"], "wish"), node("Mul", ["lidar", "steep"], "far"),
             node("Exp", ["far"], "close"), node("MatMul", ["close", "rays"], "away"),
             node("Add", ["wish", "away"], "sum"), node("Clip", ["sum", "low", "high"], "action")]
    tensors = {"steep": np.array([-8], np.float32), "low": np.array(-1, np.float32), "high": np.array(1, np.float32),
               # Turned a little to the left, so that two do not block each other.
               "rays": (-16 * np.stack([np.cos(angles - 0.6), np.sin(angles - 0.6)], 1)).astype(np.float32)}
    save(model("lidar", nodes, [value("goal", "R", 2), value("lidar", "R", 32)], [value("action", "R", 2)], tensors), "lidar")


def ids():
    """Policies that tell robots apart: a velocity for each id, one-hot and as a number."""
    nodes = [node("MatMul", ["id", "of_robot"], "own"), node("Add", ["own", "goal"], "action")]
    tensors = {"of_robot": np.array([[0.5, 0], [0, 0.25], [-0.5, -0.25]], np.float32)}
    save(model("ids", nodes, [value("goal", "R", 2), value("id", "R", 3)], [value("action", "R", 2)], tensors), "id-one-hot")
    nodes = [node("MatMul", ["id", "of_robot"], "own"), node("Add", ["own", "goal"], "action")]
    tensors = {"of_robot": np.array([[0.125, 0.25]], np.float32)}
    save(model("ids", nodes, [value("goal", "R", 2), value("id", "R", 1)], [value("action", "R", 2)], tensors), "id-number")


def hops():
    """A policy of three hops: each adds what the robot and its neighbours had in the hop before, in a number of its own."""
    first = np.array([[1, 0, 0], [0, 0, 0]], np.float32)
    save(model("say", [node("MatMul", ["goal", "first"], "message")], [value("goal", "R", 2)], [value("message", "R", 3)],
               {"first": first}), "hops-say")
    heard = [value("messages", "R", "K", 3), value("heard", "R", "K")]
    total = [node("Unsqueeze", ["heard", "two"], "there"), node("Mul", ["messages", "there"], "said"),
             node("ReduceSum", ["said", "one"], "sum", keepdims=0)]
    axes = {"one": np.array([1]), "two": np.array([2])}
    for hop in (1, 2):
        shift = np.zeros((3, 3), np.float32)
        shift[hop - 1, hop] = 1
        nodes = [*total, node("Add", ["sum", "own_message"], "all"), node("MatMul", ["all", "shift"], "added"),
                 node("Add", ["own_message", "added"], "message")]
        inputs = [*heard, value("own_message", "R", 3)]
        save(model("relay", nodes, inputs, [value("message", "R", 3)], {**axes, "shift": shift}), f"hops-relay-{hop}")
    last = np.array([[0, 0], [0, 0], [0.01, 0]], np.float32)
    nodes = [*total, node("MatMul", ["sum", "last"], "action")]
    save(model("act", nodes, heard, [value("action", "R", 2)], {**axes, "last": last}), "hops-act")


def bad():
    """What a loader has to refuse: a division by the number of neighbours, and a loop."""
    nodes = [node("ReduceSum", ["heard", "one"], "n", keepdims=1), node("Div", ["goal", "n"], "action")]
    made = model("nobody", nodes, [value("goal", "R", 2), value("heard", "R", "K")], [value("action", "R", 2)],
                 {"one": np.array([1])})
    save(made, "bad-nobody")
    nodes = [node("RandomNormalLike", ["goal"], "noise"), node("Add", ["goal", "noise"], "action")]
    made = model("chance", nodes, [value("goal", "R", 2)], [value("action", "R", 2)], {})
    save(made, "bad-chance")
    # 14 GB in a file of 300 bytes.
    nodes = [node("Unsqueeze", ["goal", "one"], "g"), node("Expand", ["g", "size"], "large"),
             node("ReduceSum", ["large", "one"], "action", keepdims=0)]
    made = model("memory", nodes, [value("goal", "R", 2)], [value("action", "R", 2)],
                 {"one": np.array([1]), "size": np.array([1, 1_800_000_000, 2])})
    save(made, "bad-memory")


recurrent()
field()
silent()
wide()
lidar()
ids()
hops()
bad()
