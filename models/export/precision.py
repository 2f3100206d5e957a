"""A graph in single precision: half the memory, and the only one that a small processor's floating-point unit has.

Whether it computes the same is checked where it is exported (models/export/formats.py).
"""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def in_single(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same graph with every float64 constant and value as float32."""
    single = onnx.ModelProto()
    single.CopyFrom(model)
    graph = single.graph
    # Types noted between nodes no longer hold; they follow from the rest.
    del graph.value_info[:]
    for item in graph.initializer:
        _narrow(item)
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.type == onnx.AttributeProto.TENSOR:
                _narrow(attribute.t)
            elif node.op_type == "Cast" and attribute.name == "to" and attribute.i == TensorProto.DOUBLE:
                attribute.CopyFrom(helper.make_attribute("to", TensorProto.FLOAT))
    return single


def _narrow(item: onnx.TensorProto) -> None:
    if item.data_type == TensorProto.DOUBLE:
        with np.errstate(over="ignore"):
            item.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(item).astype(np.float32), item.name))
