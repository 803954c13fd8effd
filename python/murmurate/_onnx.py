"""ONNX graphs of PyTorch modules: export without approximations, and runs for comparison."""

from __future__ import annotations

import contextlib
import logging
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ._hops import Refused

#: Version of ONNX's operators: the newest that all of PyTorch's exporter is written for.
OPSET = 18
#: Packages that an export needs beside PyTorch.
NEEDED = ("onnx", "onnxscript")


def check_packages() -> None:
    """Checks that what an export needs is installed."""
    import importlib.util

    missing = [name for name in ("torch", *NEEDED) if importlib.util.find_spec(name) is None]
    if missing:
        raise ValueError(f"an export to ONNX needs {', '.join(missing)}: pip install {' '.join(missing)} onnxruntime")


def graph_of(module: Any, argument: str, example: Sequence[Any], axes: Sequence[dict[int, str]]) -> bytes:
    """Returns the ONNX file of a module with the attributes ``inputs`` and ``outputs``, the names of its tensors.

    Args:
        module: The module, in evaluation.
        argument: Name of the argument that it came from, for errors.
        example: Values of the inputs.
        axes: Names of the axes of each input whose size the caller chooses.
    """
    import onnxscript.optimizer
    import torch

    try:
        with _quiet(), torch.no_grad():
            # The exporter's own optimisation takes terms such as + 1e-9 for nothing, so it is left out.
            program: Any = torch.onnx.export(
                module, tuple(example), None, input_names=list(module.inputs), output_names=list(module.outputs), dynamo=True,
                optimize=False, external_data=False, opset_version=OPSET, dynamic_shapes=(tuple(axes),), verbose=False,
            )  # fmt: skip
            # Constants are computed beforehand: a GRU cell is otherwise split by a sequence, and sizes are checked.
            onnxscript.optimizer.fold_constants(program.model)
            onnxscript.optimizer.remove_unused_nodes(program.model)
            proto = program.model_proto
    except Refused:
        raise
    except Exception as error:
        raise Refused(argument, module.module, f"PyTorch cannot export it: {_reason(error)}") from None
    return _cleaned(proto, module.outputs)


def inputs_of(data: bytes) -> list[str]:
    """Returns the names of the inputs of a graph."""
    import onnx

    return [port.name for port in onnx.load_from_string(data).graph.input]


def _cleaned(proto: Any, outputs: Sequence[str]) -> bytes:
    """Returns the file of a graph without inputs that nothing uses, and without the places in the source that made it."""
    from onnx import helper

    graph = proto.graph
    made = {name for node in graph.node for name in node.output}
    for port, name in zip(graph.output, outputs):
        if port.name != name or name not in made:
            graph.node.append(helper.make_node("Identity", [port.name], [name]))
            port.name = name
    for node in [node for node in graph.node if node.op_type == "Mish"]:
        # The program's engine does not have it.
        at, (x, y) = list(graph.node).index(node), (node.input[0], node.output[0])
        chain = [("Softplus", [x], f"{y}.softplus"), ("Tanh", [f"{y}.softplus"], f"{y}.tanh"), ("Mul", [x, f"{y}.tanh"], y)]
        graph.node.remove(node)
        for offset, (kind, inputs, output) in enumerate(chain):
            graph.node.insert(at + offset, helper.make_node(kind, inputs, [output]))
    used = {name for node in graph.node for name in node.input}
    unused = [port for port in graph.input if port.name not in used]
    for port in unused:
        graph.input.remove(port)
    for part in (proto, graph, *graph.node, *graph.input, *graph.output, *graph.initializer):
        part.doc_string = ""
        if hasattr(part, "metadata_props"):
            del part.metadata_props[:]
    for node in graph.node:
        # The program's engine does not know the attribute, of which 0 is the default.
        for attribute in [one for one in node.attribute if one.name == "layout" and one.i == 0]:
            node.attribute.remove(attribute)
    del graph.value_info[:]
    return bytes(proto.SerializeToString())


def _reason(error: BaseException) -> str:
    """Returns the first words of what was at the bottom of an error."""
    while error.__cause__ is not None:
        error = error.__cause__
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    # A line that ends with a colon says nothing without the next.
    several = lines[:3] if lines and lines[0].endswith(":") else lines[:1]
    return (" ".join(several) or type(error).__name__)[:300]


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keeps the exporter from its warnings and its log, which are about other packages and about names of axes."""
    levels = {logging.getLogger(name): logging.getLogger(name).level for name in ("torch.onnx", "onnxscript")}
    try:
        for logger in levels:
            logger.setLevel(logging.ERROR)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in levels.items():
            logger.setLevel(level)


class Session:
    """Graph that can be run: by onnxruntime where it is installed, else by ONNX's own reference implementation.

    Attributes:
        inputs: Names of its inputs.
        outputs: Names of its outputs.
    """

    def __init__(self, data: bytes):
        try:
            import onnxruntime

            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = 1
            options.log_severity_level = 3
            session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
            self.inputs = [port.name for port in session.get_inputs()]
            self.outputs = [port.name for port in session.get_outputs()]
        except ImportError:
            import onnx
            from onnx.reference import ReferenceEvaluator

            session = ReferenceEvaluator(onnx.load_from_string(data))
            self.inputs, self.outputs = session.input_names, session.output_names
        self._session: Any = session

    def run(self, inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Returns the outputs by name. Inputs that the graph does not have are left out."""
        given = {name: inputs[name] for name in self.inputs}
        return dict(zip(self.outputs, self._session.run(None, given)))
