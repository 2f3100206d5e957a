"""ONNX graphs written node by node, for models that no exporter gets right.

A graph computes in float64 between its float32 input and output: polynomials and kernels lose digits in between,
and at this size the width costs nothing.
"""

from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 18
OPSET_ML = 3


class GraphBuilder:
    """Collects nodes. A value is known by its name, a string."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []
        self._count = 0

    def name(self) -> str:
        """A value's name that is not taken."""
        self._count += 1
        return f"t{self._count}"

    def constant(self, value: Any, dtype: type = np.float64) -> str:
        """A constant tensor."""
        name = self.name()
        self.constants.append(numpy_helper.from_array(np.array(value, dtype), name))
        return name

    def op(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """A node with one output."""
        name = self.name()
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def cast(self, value: str, dtype: int) -> str:
        """The value in another element type of `onnx.TensorProto`."""
        return self.op("Cast", value, to=dtype)

    def columns(self, value: str, which: np.ndarray) -> str:
        """Columns of a (B, F) value: (B,) + the shape of `which`."""
        return self.op("Gather", value, self.constant(which, np.int64), axis=1)

    def total(self, value: str, axis: int, keep: bool = False) -> str:
        """The sum along an axis."""
        return self.op("ReduceSum", value, self.constant([axis], np.int64), keepdims=int(keep))

    def model(self, estimate: str, features: int, outputs: int) -> onnx.ModelProto:
        """The checked model: `features` (B, F) float32 -> `estimate` (B, K) float32."""
        self.nodes.append(helper.make_node("Cast", [estimate], ["estimate"], to=TensorProto.FLOAT))
        graph = helper.make_graph(
            self.nodes,
            "softslide",
            [helper.make_tensor_value_info("features", TensorProto.FLOAT, ["B", features])],
            [helper.make_tensor_value_info("estimate", TensorProto.FLOAT, ["B", outputs])],
            self.constants,
        )
        opsets = [helper.make_opsetid("", OPSET), helper.make_opsetid("ai.onnx.ml", OPSET_ML)]
        model = helper.make_model(graph, opset_imports=opsets, ir_version=10)
        onnx.checker.check_model(model, full_check=True)
        return model
