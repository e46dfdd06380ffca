"""A policy as an ONNX model, built node by node. The only module that imports onnx."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core import Deployed, FloatArray, JointLayers, Layer
from ..errors import MachineError
from ..system.files import writing

OPSET = 17
"""The first version with LayerNormalization; runtimes since 2022 support it."""
IR_VERSION = 8
"""The version of the file format of the same release (ONNX 1.12)."""


def check_onnx() -> None:
    """Raise a MachineError if the package onnx is missing."""
    try:
        import onnx  # noqa: F401, PLC0415  (optional)
    except ImportError as error:
        raise MachineError(
            "policy.onnx needs the package onnx", hint="pip install 'karolos[onnx]', or leave it out with --no-onnx"
        ) from error


def write_onnx(path: Path, policy: Deployed, sizes: tuple[int, int], facts: Mapping[str, str]) -> None:
    """Check the model and write it.

    Inputs: `observation` (n, o), and `desired_goal` (n, g) if there are goals. Output: `action`, float32 (n, a) in
    [-1, 1], or for a discrete set the index, int64 (n,).

    Args:
        sizes: o and g; g is 0 without goals.
        facts: texts for the model's metadata.

    Raises MachineError if the file cannot be written.
    """
    import onnx  # noqa: PLC0415  (optional)

    model = _model(policy, sizes)
    onnx.helper.set_model_props(model, dict(facts))
    onnx.checker.check_model(model, full_check=True)
    with writing(path):
        path.write_bytes(model.SerializeToString())


def run_onnx(path: Path, inputs: Mapping[str, FloatArray]) -> FloatArray:
    """The actions of the model, computed by ONNX's reference implementation; surplus `inputs` are ignored."""
    from onnx.reference import ReferenceEvaluator  # noqa: PLC0415  (optional)

    model = ReferenceEvaluator(str(path))
    (found,) = model.run(["action"], {name: inputs[name] for name in model.input_names})
    return np.asarray(found)


class _Graph:
    """Nodes and constants of a model. A node's name is that of its output."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, name: str, value: Any) -> str:
        from onnx import numpy_helper  # noqa: PLC0415  (optional)

        self.constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def node(self, kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        from onnx import helper  # noqa: PLC0415  (optional)

        self.nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    def split(self, x: str, sizes: list[int], outputs: list[str], **attributes: Any) -> None:
        from onnx import helper  # noqa: PLC0415  (optional)

        parts = self.constant(f"{x}_parts", np.array(sizes))
        self.nodes.append(helper.make_node("Split", [x, parts], outputs, name=f"{x}_split", **attributes))

    def bounded(self, x: str, most: float, output: str) -> str:
        limits = [(f"{output}_{name}", np.float32(limit)) for name, limit in (("low", -most), ("high", most))]
        return self.node("Clip", [x, *(self.constant(*limit) for limit in limits)], output)

    def of_each(self, x: str, layer: Layer, output: str) -> str:
        """The layer of each joint: (n, s, in) -> (n, s, out)."""
        product = self.node("MatMul", [x, self.constant(f"{output}_weight", layer.weight.T)], f"{output}_product")
        return self.node("Add", [product, self.constant(f"{output}_bias", layer.bias)], output)


def _model(policy: Deployed, sizes: tuple[int, int]) -> Any:
    from onnx import TensorProto, helper  # noqa: PLC0415  (optional)

    from ..records import provenance  # noqa: PLC0415

    graph = _Graph()
    constant, node = graph.constant, graph.node
    names = [name for name, size in zip(("observation", "desired_goal"), sizes, strict=True) if size]
    inputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", size])
        for name, size in zip(names, [size for size in sizes if size], strict=True)
    ]
    missing = policy.missing.shape[1]
    if missing:
        parts = [
            node("Gather", [name, constant(f"{name}_columns", columns)], f"{name}_part", axis=1)
            for name, columns in (("desired_goal", policy.missing[0]), ("observation", policy.missing[1]))
        ]
        names.append(node("Sub", parts, "missing"))
    x = node("Concat", names, "observed", axis=1)
    x = node("Sub", [x, constant("shift", policy.shift)], "centred")
    x = node("Mul", [x, constant("scale", policy.scale)], "scaled")
    if missing:
        graph.split(x, [policy.shift.size - missing, missing], ["known", "far"], axis=1)
        near = node("Tanh", ["far"], "near")
        x = node("Concat", [graph.bounded("known", policy.clip, "clipped"), near], "normalised", axis=1)
    else:
        x = graph.bounded(x, policy.clip, "normalised")
    x = _perceptron(graph, policy, x if policy.joints is None else _pooled(graph, policy.joints, x))
    columns = policy.layers[-1].bias.size
    if policy.joints is not None:
        columns = policy.joints.order.size
        x = _of_joints(graph, policy.joints, x)
    if policy.output == "argmax":
        node("ArgMax", [x], "action", axis=1, keepdims=0)
        output = helper.make_tensor_value_info("action", TensorProto.INT64, ["n"])
    else:
        if policy.output == "tanh":
            node("Tanh", [x], "action")
        else:
            graph.bounded(x, 1, "action")
        output = helper.make_tensor_value_info("action", TensorProto.FLOAT, ["n", columns])
    return helper.make_model(
        helper.make_graph(graph.nodes, "policy", inputs, [output], graph.constants),
        producer_name="karolos",
        producer_version=provenance.versions()["karolos"],
        ir_version=IR_VERSION,
        opset_imports=[helper.make_opsetid("", OPSET)],
    )


def _perceptron(graph: _Graph, policy: Deployed, x: str) -> str:
    constant, node = graph.constant, graph.node
    for place, layer in enumerate(policy.layers):
        if place and policy.layer_norm is not None:
            ones = constant(f"ones{place}", np.ones(layer.weight.shape[1], np.float32))
            x = node("LayerNormalization", [x, ones], f"even{place}", axis=-1, epsilon=policy.layer_norm)
        if place:
            x = node("Relu", [x], f"hidden{place}")
        parameters = [constant(f"weight{place}", layer.weight), constant(f"bias{place}", layer.bias)]
        x = node("Gemm", [x, *parameters], f"layer{place}", transB=1)
    return x


def _pooled(graph: _Graph, joints: JointLayers, x: str) -> str:
    """The input of the perceptron; p, q, r, t and v are the parts of `JointLayers`, (n, s, h) each."""
    constant, node = graph.constant, graph.node
    table = np.hstack((joints.own, np.tile(joints.shared, (len(joints.own), 1))))
    rows = node("Gather", [x, constant("row_columns", table)], "rows", axis=1)
    graph.split(graph.of_each(rows, joints.first, "first"), [joints.units] * 5, list("pqrtv"), axis=2)
    terms = [node("Relu", ["p"], "rectified"), node("Mul", ["q", "r"], "products")]
    over = constant("over_joints", np.array([1]))
    sums = [node("ReduceSum", [one, over], f"{one}_sum", keepdims=0) for one in terms]
    root = constant("root", np.float32(len(joints.own) ** 0.5))
    shared = node("Gather", [x, constant("shared_columns", joints.shared)], "shared", axis=1)
    return node("Concat", [*(node("Div", [one, root], f"{one}_root") for one in sums), shared], "pooled", axis=1)


def _of_joints(graph: _Graph, joints: JointLayers, x: str) -> str:
    """The outputs from those of the perceptron, which are y, z and the rest of `JointLayers`."""
    constant, node, each = graph.constant, graph.node, joints.last.bias.size * len(joints.own)
    parts = [joints.units, joints.units, joints.order.size - each]
    graph.split(x, parts, ["y", "z", "rest"], axis=1)
    ahead = constant("ahead", np.array([1]))
    y, z = (node("Unsqueeze", [name, ahead], f"{name}_of_all") for name in ("y", "z"))
    hidden = [node("Relu", [node("Add", ["t", y], "shifted")], "switched"), node("Mul", ["v", z], "gated")]
    last = graph.of_each(node("Concat", hidden, "last_hidden", axis=2), joints.last, "last")
    flat = node("Reshape", [last, constant("flat", np.array([0, each]))], "each")
    both = node("Concat", [flat, "rest"], "unordered", axis=1)
    return node("Gather", [both, constant("order", joints.order)], "outputs", axis=1)
