"""Large constants of a graph in half precision: half the bytes of a bundle, single precision at work.

Only what half precision holds to the last bit is packed, so that the graph computes the same; a model that wants to be
small rounds its weights first (`rounded`). ONNX Runtime undoes the casts once, as it loads the graph.
"""

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

# Numbers in a constant; below this a cast takes as many bytes as it saves.
LEAST = 128


def rounded(values: torch.Tensor) -> torch.Tensor:
    """float32 values as half precision holds them (11 bits)."""
    return values.half().float()


def pack(graph: onnx.ModelProto) -> None:
    """Stores the graph's large float32 constants as float16, each with a cast in front of what reads it."""
    casts = []
    for item in graph.graph.initializer:
        value = numpy_helper.to_array(item)
        if item.data_type != TensorProto.FLOAT or value.size < LEAST:
            continue
        with np.errstate(over="ignore"):
            half = value.astype(np.float16)
        if not np.array_equal(half.astype(np.float32), value):
            continue
        name = item.name
        item.CopyFrom(numpy_helper.from_array(half, name))
        casts.append(helper.make_node("Cast", [name], [f"{name}_"], to=TensorProto.FLOAT))
        for node in graph.graph.node:
            node.input[:] = [f"{name}_" if given == name else given for given in node.input]
    nodes = [*casts, *graph.graph.node]
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)


def unpack(graph: onnx.ModelProto) -> None:
    """Undoes `pack`."""
    packed = {item.name: item for item in graph.graph.initializer if item.data_type == TensorProto.FLOAT16}
    names: dict[str, str] = {}
    nodes = []
    for node in graph.graph.node:
        if node.op_type == "Cast" and node.input[0] in packed:
            item = packed[node.input[0]]
            value = numpy_helper.to_array(item).astype(np.float32)
            item.CopyFrom(numpy_helper.from_array(value, item.name))
            names[node.output[0]] = item.name
        else:
            node.input[:] = [names.get(given, given) for given in node.input]
            nodes.append(node)
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)
