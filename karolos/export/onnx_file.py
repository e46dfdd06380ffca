"""A policy as an ONNX model, built node by node. The only module that imports onnx."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core import Deployed, FloatArray
from ..errors import MachineError
from ..files import writing

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


def _model(policy: Deployed, sizes: tuple[int, int]) -> Any:
    from onnx import TensorProto, helper, numpy_helper  # noqa: PLC0415  (optional)

    from ..records import provenance  # noqa: PLC0415

    nodes, constants = [], []

    def constant(name: str, value: Any) -> str:
        constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def node(kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [output], name=output, **attributes))
        return output

    def bounded(x: str, most: float, output: str) -> str:
        limits = [constant(f"{output}_{name}", np.float32(limit)) for name, limit in (("low", -most), ("high", most))]
        return node("Clip", [x, *limits], output)

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
        known = constant("parts", np.array([policy.shift.size - missing, missing]))
        nodes.append(helper.make_node("Split", [x, known], ["known", "far"], name="split", axis=1))
        x = node(
            "Concat", [bounded("known", policy.clip, "clipped"), node("Tanh", ["far"], "near")], "normalised", axis=1
        )
    else:
        x = bounded(x, policy.clip, "normalised")
    for place, layer in enumerate(policy.layers):
        if place and policy.layer_norm is not None:
            ones = constant(f"ones{place}", np.ones(layer.weight.shape[1], np.float32))
            x = node("LayerNormalization", [x, ones], f"even{place}", axis=-1, epsilon=policy.layer_norm)
        if place:
            x = node("Relu", [x], f"hidden{place}")
        parameters = [constant(f"weight{place}", layer.weight), constant(f"bias{place}", layer.bias)]
        x = node("Gemm", [x, *parameters], f"layer{place}", transB=1)
    if policy.output == "argmax":
        node("ArgMax", [x], "action", axis=1, keepdims=0)
        output = helper.make_tensor_value_info("action", TensorProto.INT64, ["n"])
    else:
        if policy.output == "tanh":
            node("Tanh", [x], "action")
        else:
            bounded(x, 1, "action")
        output = helper.make_tensor_value_info("action", TensorProto.FLOAT, ["n", policy.layers[-1].bias.size])
    graph = helper.make_graph(nodes, "policy", inputs, [output], constants)
    return helper.make_model(
        graph,
        producer_name="karolos",
        producer_version=provenance.versions()["karolos"],
        ir_version=IR_VERSION,
        opset_imports=[helper.make_opsetid("", OPSET)],
    )
