"""Makes two policies with messages as large as those of published teams, and what they answer by a computation in numpy.

    python make.py [FOLDER]        needs numpy and onnx; all 1000 steps go to FOLDER if that is given

Weights are random, since those of the published teams cannot be passed on under the licence of this project: these policies drive to their goals and away from what
their lidar sees, and what they hear changes that by at most a tenth.
"""

import json
import pathlib
import sys

import numpy as np
import onnx
from onnx import TensorProto, helper

HERE = pathlib.Path(__file__).parent
DATA = HERE.parents[2] / "tests" / "onnx" / "data" / "others"
RAYS, ROBOTS, STEPS = 32, 4, 1000
#: Layers of the filter, hops of a layer, width of a layer, and rank of its weights, which keeps the file small.
LAYERS, HOPS, WIDE, RANK = 5, 3, 256, 8
WIDTHS = [RAYS + 2] + [WIDE] * (LAYERS - 1)
#: Rows and columns of the embedding: tokens of an image, and features of each.
TOKENS, FEATURES = 128, 96
ANGLES = -np.pi + np.arange(RAYS) * np.pi / 16
#: Directions away from the rays of the lidar, turned a little to the left, so that two robots do not block each other.
AWAY = -16 * np.stack([np.cos(ANGLES - 0.6), np.sin(ANGLES - 0.6)], 1)


def drawn(*shapes):
    """Returns random weights, scaled by the width of what they are multiplied with."""
    rng = np.random.default_rng(11)
    return [(rng.normal(0, 1, shape) / shape[0] ** 0.5).astype(np.float32) for shape in shapes]


class Nodes(list):
    """Operators of a graph, and its constants."""

    def __init__(self):
        super().__init__()
        self.tensors = {}

    def constant(self, value, kind=np.float32):
        name = f"c{len(self.tensors)}"
        self.tensors[name] = np.asarray(value, kind)
        return name

    def add(self, kind, *inputs, output=None, **attributes):
        """Adds an operator; inputs that are no names become constants. Returns the name of its output."""
        output = output or f"t{len(self)}"
        given = [one if isinstance(one, str) else self.constant(one) for one in inputs]
        self.append(helper.make_node(kind, given, [output], **attributes))
        return output

    def whole(self, kind, x, *numbers, **attributes):
        """Adds an operator with axes or sizes, each a list of whole numbers."""
        return self.add(kind, x, *(self.constant(one, np.int64) for one in numbers), **attributes)

    def act(self, more):
        """Adds the action: towards the goal, away from what the lidar sees, and a tenth of what ``more`` says."""
        wish = self.add("Clip", "goal", self.constant(-1.0), self.constant(1.0))
        away = self.add("MatMul", self.add("Exp", self.add("Mul", "lidar", [-8.0])), AWAY)
        field = self.add("Add", self.add("Add", wish, away), self.add("Mul", self.add("Tanh", more), [0.1]))
        self.add("Clip", field, self.constant(-1.0), self.constant(1.0), output="action")


def save(name, nodes, message):
    value = lambda key, *shape: helper.make_tensor_value_info(key, TensorProto.FLOAT, ["R", *shape])
    inputs = [value("goal", 2), value("lidar", RAYS), value("messages", "K", message), value("heard", "K")]
    constants = [onnx.numpy_helper.from_array(array, key) for key, array in nodes.tensors.items()]
    graph = helper.make_graph(nodes, name, inputs, [value("action", 2), value("message", message)], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    onnx.checker.check_model(model, full_check=True)
    (HERE / f"{name}.onnx").write_bytes(model.SerializeToString())


class Filter:
    """A filter over the graph of the team, as LPAC's: five layers of convolutions of three hops (arXiv 2401.04855).

    A message has, layer after layer, what the sender knows 0, 1 and 2 hops away, and the number of robots that it hears. What
    arrives is a hop older with each step, so on a team that stays the action is that of the whole team's convolutions 15 steps later.
    """

    message = HOPS * sum(WIDTHS) + 1

    def __init__(self):
        self.taps = [drawn(((HOPS + 1) * wide, RANK), (RANK, WIDE)) for wide in WIDTHS]
        (self.head,) = drawn((WIDE, 2))

    def nodes(self):
        n = Nodes()
        degree = n.whole("ReduceSum", "heard", [1], keepdims=1)
        theirs = n.whole("Squeeze", n.whole("Slice", "messages", [self.message - 1], [self.message], [2]), [2])
        root = n.add("Sqrt", n.add("Mul", n.add("Max", theirs, [1.0]), n.add("Max", degree, [1.0])))
        weight = n.whole("Unsqueeze", n.add("Div", "heard", root), [2])
        known = n.whole("Slice", "messages", [0], [self.message - 1], [2])
        got = n.whole("ReduceSum", n.add("Mul", known, weight), [1], keepdims=0)
        x, said, at = n.add("Concat", "lidar", "goal", axis=1), [], 0
        for wide, (first, second) in zip(WIDTHS, self.taps):
            hop = n.whole("Slice", got, [at], [at + HOPS * wide], [1])
            own = n.add("Concat", x, hop, axis=1)
            said.append(n.whole("Slice", own, [0], [HOPS * wide], [1]))
            x, at = n.add("Relu", n.add("MatMul", n.add("MatMul", own, first), second)), at + HOPS * wide
        n.add("Concat", *said, degree, axis=1, output="message")
        n.act(n.add("MatMul", x, self.head))
        return n

    def step(self, goal, lidar, messages):
        """The same in numpy, in double precision, for one robot and the messages that it hears."""
        degree, got = float(len(messages)), np.zeros(self.message - 1)
        for message in messages:
            got += message[:-1] / np.sqrt(max(message[-1], 1.0) * max(degree, 1.0))
        x, said, at = np.concatenate([lidar, goal]), [], 0
        for wide, (first, second) in zip(WIDTHS, self.taps):
            own = np.concatenate([x, got[at : at + HOPS * wide]])
            said.append(own[: HOPS * wide])
            x, at = np.maximum(own @ np.float64(first) @ second, 0), at + HOPS * wide
        return x @ np.float64(self.head), np.concatenate([*said, [degree]])


class Embedding:
    """An embedding of what a robot sees, of the size of CoViS-Net's (arXiv 2405.01107): 128 tokens of 96 features.

    The robot asks the tokens of each neighbour by its own embedding, and adds what it is answered.
    """

    message = TOKENS * FEATURES

    def __init__(self):
        self.see, self.head = drawn((RAYS + 2, FEATURES), (FEATURES, 2))
        (self.place,) = drawn((TOKENS, 1))

    def nodes(self):
        n = Nodes()
        seen = n.add("Tanh", n.add("MatMul", n.add("Concat", "lidar", "goal", axis=1), self.see))
        tokens = n.add("Tanh", n.add("Add", n.whole("Unsqueeze", seen, [1]), self.place[None]))
        n.whole("Reshape", tokens, [0, self.message], output="message")
        theirs = n.whole("Reshape", "messages", [0, -1, TOKENS, FEATURES])
        asked = n.whole("Unsqueeze", seen, [1, 2])
        score = n.add("Mul", n.whole("ReduceSum", n.add("Mul", theirs, asked), [3], keepdims=1), [FEATURES**-0.5])
        answer = n.whole("ReduceSum", n.add("Mul", theirs, n.add("Softmax", score, axis=2)), [2], keepdims=0)
        heard = n.add("Mul", answer, n.whole("Unsqueeze", "heard", [2]))
        both = n.add("Add", seen, n.whole("ReduceSum", heard, [1], keepdims=0))
        n.act(n.add("MatMul", both, self.head))
        return n

    def step(self, goal, lidar, messages):
        """The same in numpy, in double precision, for one robot and the messages that it hears."""
        seen = np.tanh(np.concatenate([lidar, goal]) @ np.float64(self.see))
        both = seen.copy()
        for message in messages:
            theirs = message.reshape(TOKENS, FEATURES)
            weight = np.exp(theirs @ seen * FEATURES**-0.5)
            both += (weight / weight.sum()) @ theirs
        return both @ np.float64(self.head), np.tanh(seen[None] + np.float64(self.place)).reshape(-1)


def steps(policy):
    """Returns steps of a team whose neighbours change, by numpy alone."""
    rng, said, found = np.random.default_rng(4), np.zeros((ROBOTS, policy.message)), []
    plain = lambda values, digits=7: [float(f"{value:.{digits}g}") for value in np.float64(values)]
    for at in range(STEPS):
        reset = at % 100 == 0
        said = np.zeros_like(said) if reset else said
        robots, after = [], []
        for robot in range(ROBOTS):
            goal, lidar = np.float32(rng.normal(0, 0.4, 2)), np.float32(rng.uniform(0.2, 2, RAYS))
            goal, lidar = np.float32(plain(goal, 4)), np.float32(plain(lidar, 4))
            near = [other for other in range(ROBOTS) if other != robot and rng.random() < 0.5]
            more, message = policy.step(np.float64(goal), np.float64(lidar), [said[other] for other in near])
            wish = np.clip(goal, -1, 1) + np.exp(-8.0 * np.float64(lidar)) @ AWAY
            action = np.clip(wish + 0.1 * np.tanh(more), -1, 1)
            given = {"goal": plain(goal, 4), "lidar": plain(lidar, 4)}
            expected = {"action": plain(action), "message": plain(message[:: len(message) // 8][:8])}
            robots.append({"given": given, "near": near, "expected": expected})
            after.append(message)
        said = np.array(after)
        found.append({"reset": reset, "robots": robots})
    return found


def write(path, steps):
    lines = ",\n".join(json.dumps(one) for one in steps)
    path.write_text(f'{{"robots": {ROBOTS}, "steps": [\n{lines}\n]}}\n')


if __name__ == "__main__":
    for name, policy in (("filter", Filter()), ("embedding", Embedding())):
        save(name, policy.nodes(), policy.message)
        all_steps = steps(policy)
        write(DATA / f"sizes-{name}.json", all_steps[:60])
        if len(sys.argv) > 1:
            write(pathlib.Path(sys.argv[1]) / f"sizes-{name}.json", all_steps)
        print(f"{name}: {policy.message} floats")
