"""Makes the graph of JaxMARL's team in this folder from the agent that its authors have published.

    python make.py WEIGHTS        needs numpy and onnx, and MPE_simple_spread_v3-vdn_ps.safetensors (README.md says where it is from)
"""

import json
import pathlib
import struct
import sys

import numpy as np
import onnx
from onnx import TensorProto, helper

HERE = pathlib.Path(__file__).parent
ROBOTS, STATE = 3, 64


def weights(path):
    """Returns the weights of an agent by their names."""
    raw = pathlib.Path(path).read_bytes()
    (length,) = struct.unpack("<Q", raw[:8])
    head = json.loads(raw[8 : 8 + length])
    body = raw[8 + length :]
    array = lambda entry: np.frombuffer(body[slice(*entry["data_offsets"])], "<f4").reshape(entry["shape"])
    return {key.removeprefix("params,"): array(entry) for key, entry in head.items() if key != "__metadata__"}


def graph(tensors):
    """Returns the graph of an agent: a dense layer, a GRU cell of flax, and a dense layer of five values of actions."""
    node = lambda kind, inputs, output, **attributes: helper.make_node(kind, inputs, [output], **attributes)
    cell = "ScannedRNN_0,GRUCell_0,"
    nodes = [
        node("Unsqueeze", ["heard", "two"], "there"),
        # JaxMARL says nothing of a neighbour that is not heard, since that never happens there; it is left at the robot.
        node("Mul", ["edges", "there"], "known"),
        node("Reshape", ["known", "row"], "others"),
        node("Reshape", ["landmarks", "row"], "marks"),
        node("Mul", ["others", "zero"], "silence"),
        node("Concat", ["velocity", "position", "marks", "others", "silence", "id"], "x", axis=1),
        node("MatMul", ["x", "Dense_0,kernel"], "x0"),
        node("Add", ["x0", "Dense_0,bias"], "x1"),
        node("Relu", ["x1"], "own"),
    ]
    for gate in "rz":
        nodes += [
            node("MatMul", ["own", f"{cell}i{gate},kernel"], f"i{gate}0"),
            node("Add", [f"i{gate}0", f"{cell}i{gate},bias"], f"i{gate}"),
            node("MatMul", ["state", f"{cell}h{gate},kernel"], f"h{gate}"),
            node("Add", [f"i{gate}", f"h{gate}"], f"{gate}0"),
            node("Sigmoid", [f"{gate}0"], gate),
        ]
    nodes += [
        node("MatMul", ["own", f"{cell}in,kernel"], "in0"),
        node("Add", ["in0", f"{cell}in,bias"], "in"),
        node("MatMul", ["state", f"{cell}hn,kernel"], "hn0"),
        node("Add", ["hn0", f"{cell}hn,bias"], "hn"),
        node("Mul", ["r", "hn"], "rn"),
        node("Add", ["in", "rn"], "n0"),
        node("Tanh", ["n0"], "n"),
        node("Sub", ["one", "z"], "new"),
        node("Mul", ["new", "n"], "added"),
        node("Mul", ["z", "state"], "kept"),
        node("Add", ["added", "kept"], "state_next"),
        node("MatMul", ["state_next", "Dense_1,kernel"], "q"),
        node("Add", ["q", "Dense_1,bias"], "action"),
    ]
    value = lambda name, *shape: helper.make_tensor_value_info(name, TensorProto.FLOAT, ["R", *shape])
    inputs = [value("velocity", 2), value("position", 2), value("landmarks", ROBOTS, 2), value("edges", ROBOTS - 1, 2)]
    inputs += [value("heard", ROBOTS - 1), value("id", ROBOTS), value("state", STATE)]
    outputs = [value("action", 5), value("state_next", STATE)]
    constants = {**tensors, "two": np.array([2]), "row": np.array([0, -1]), "one": np.float32([1]), "zero": np.float32([0])}
    made = [onnx.numpy_helper.from_array(np.asarray(array), key) for key, array in constants.items()]
    built = helper.make_graph(nodes, "spread", inputs, outputs, made)
    model = helper.make_model(built, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    onnx.checker.check_model(model, full_check=True)
    return model


if __name__ == "__main__":
    (HERE / "spread.onnx").write_bytes(graph(weights(sys.argv[1])).SerializeToString())
