"""Comparison of graphs with given answers in the program's own engine, by a graph that is finite only if they agree."""

from __future__ import annotations

import dataclasses
import pathlib
import tempfile
from collections.abc import Sequence
from typing import Any

import numpy as np

from ._contract import CHANNELS, Contract, Input
from ._program import finished

#: Differences that are asked for one after the other, to say how large one is.
LADDER = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
#: Largest number of operators of a graph that asks for several samples; the program takes 20 000.
MOST_NODES = 15_000


@dataclasses.dataclass
class Sample:
    """Inputs of a graph, and what the module answers.

    Attributes:
        role: Role of the graph.
        said: Words that describe the inputs.
        inputs: Values of the inputs by name.
        outputs: Outputs of the module by name.
    """

    role: str
    said: str
    inputs: dict[str, np.ndarray]
    outputs: dict[str, np.ndarray]


def differing(graphs: dict[str, bytes], samples: Sequence[Sample], tolerance: float) -> tuple[Sample, str, float] | None:
    """Returns a sample for which the program's engine differs from the module, by more than the tolerance (relative above 1).

    With it are the name of the output and a number that the difference exceeds. None if there is no such sample.
    """
    import onnx

    everything = [(sample, name) for sample in samples for name in sample.outputs]
    # One graph for all of them, unless it would have more operators than the program takes.
    sizes = {role: len(onnx.load_from_string(data).graph.node) for role, data in graphs.items()}
    few = sum(sizes[sample.role] for sample in samples) < MOST_NODES
    together = [everything] if few else [[(sample, name) for name in sample.outputs] for sample in samples]
    if all(_agree(graphs, some, tolerance) for some in together):
        return None
    for sample, name in everything:
        if not _agree(graphs, [(sample, name)], tolerance):
            over = [step for step in LADDER if step >= tolerance and not _agree(graphs, [(sample, name)], step)]
            return sample, name, max(over, default=tolerance)
    raise AssertionError("an answer differs alone, too")


def _agree(graphs: dict[str, bytes], asked: Sequence[tuple[Sample, str]], tolerance: float) -> bool:
    """Whether the program's engine computes these outputs."""
    goal = Input("goal", "goal", (2,), CHANNELS["goal"][1], "policy")
    action = {"kind": "velocity", "unit": "m/s", "limit": 1.0, "distribution": "none"}
    contract = Contract("probe", {"graph": "probe.onnx"}, 20.0, 2.0, 0.2, 1, "exact", [goal], None, 0, 0, 0.5, action)
    with tempfile.TemporaryDirectory() as folder:
        (pathlib.Path(folder) / "probe.onnx").write_bytes(_probe(graphs, asked, tolerance))
        file = pathlib.Path(folder) / "probe.policy.toml"
        file.write_text(contract.text(None), encoding="utf-8")
        try:
            finished(["policy", "check", str(file), "--json"])
        except ValueError as error:
            if "is not finite" in str(error):
                return False
            raise
    return True


def _probe(graphs: dict[str, bytes], asked: Sequence[tuple[Sample, str]], tolerance: float) -> bytes:
    """Returns a graph whose action is its input ``goal``, and not a number if an output is another than asked."""
    import onnx
    from onnx import TensorProto, compose, helper, numpy_helper

    whole, ends, nodes, weights = {}, [], [], []
    for role in {sample.role: None for sample, _ in asked}:
        # Names of its own for each graph; copies of a graph share its weights.
        whole[role] = compose.add_prefix(onnx.load_from_string(graphs[role]), f"{role}.")
        weights += list(whole[role].graph.initializer)
    copies: list[Sample] = []
    for at, (sample, name) in enumerate(asked):
        if not any(sample is other for other in copies):
            copies.append(sample)
            prefix = f"{len(copies)}."
            copied = compose.add_prefix(whole[sample.role], prefix, rename_initializers=False).graph
            nodes += list(copied.node)
            for port in copied.input:
                given = sample.inputs[port.name.removeprefix(f"{prefix}{sample.role}.")]
                weights.append(numpy_helper.from_array(np.ascontiguousarray(given, np.float32), port.name))
        number = next(number for number, other in enumerate(copies, 1) if other is sample)
        expected, place = sample.outputs[name], f"check.{at}."
        divisor = np.maximum(np.abs(expected), 1.0).astype(np.float32)
        weights += [numpy_helper.from_array(expected, place + "expected"), numpy_helper.from_array(divisor, place + "divisor")]
        chain = [
            ("Sub", [f"{number}.{sample.role}.{name}", place + "expected"], "off"),
            ("Abs", [place + "off"], "size"),
            ("Div", [place + "size", place + "divisor"], "relative"),
            ("ReduceMax", [place + "relative"], "worst"),
            ("LessOrEqual", [place + "worst", "tolerance"], "agrees"),
            ("Where", [place + "agrees", "nothing", "not-a-number"], "end"),
        ]
        for kind, inputs, output in chain:
            options: dict[str, Any] = {"keepdims": 0} if kind == "ReduceMax" else {}
            nodes.append(helper.make_node(kind, inputs, [place + output], **options))
        ends.append(place + "end")
    for key, value in (("tolerance", tolerance), ("nothing", 0.0), ("not-a-number", np.nan)):
        weights.append(numpy_helper.from_array(np.array(value, np.float32), key))
    nodes.append(helper.make_node("Sum", ["goal", *ends], ["action"]))
    ports = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["R", 2]) for name in ("goal", "action")]
    graph = helper.make_graph(nodes, "probe", ports[:1], ports[1:], weights)
    first = next(iter(whole.values()))
    made = helper.make_model(graph, opset_imports=list(first.opset_import), ir_version=first.ir_version)
    return bytes(made.SerializeToString())
