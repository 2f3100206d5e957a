"""Large constants of a graph in as few bytes as hold them to the last bit: half a bundle, all precision at work.

Nothing is rounded, so that the graph computes the same; a model that wants to be small rounds its constants first
(`rounded`). ONNX Runtime undoes the casts once, as it loads the graph.
"""

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper

# Numbers in a constant; below this a cast takes as many bytes as it saves.
LEAST = 128
_WHOLE = "_"  # ends the name of what a cast gives


def rounded(values: torch.Tensor) -> torch.Tensor:
    """float32 values as half precision holds them (11 bits)."""
    return values.half().float()


def pack(graph: onnx.ModelProto) -> None:
    """Stores the graph's large constants in half or single precision where that is exact, each with a cast in front of
    what reads it."""
    casts = []
    for item in graph.graph.initializer:
        value = numpy_helper.to_array(item)
        if value.dtype not in (np.float32, np.float64) or value.size < LEAST:
            continue
        packed = _smallest(value)
        if packed.dtype == value.dtype:
            continue
        name, kind = item.name, item.data_type
        item.CopyFrom(numpy_helper.from_array(packed, name))
        casts.append(helper.make_node("Cast", [name], [name + _WHOLE], to=kind))
        for node in graph.graph.node:
            node.input[:] = [name + _WHOLE if given == name else given for given in node.input]
    nodes = [*casts, *graph.graph.node]
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)


def unpack(graph: onnx.ModelProto) -> None:
    """Undoes `pack`."""
    constants = {item.name: item for item in graph.graph.initializer}
    names: dict[str, str] = {}
    nodes = []
    for node in graph.graph.node:
        name = node.input[0] if node.input else ""
        if node.op_type == "Cast" and name in constants and node.output[0] == name + _WHOLE:
            kind = helper.tensor_dtype_to_np_dtype(node.attribute[0].i)
            value = numpy_helper.to_array(constants[name]).astype(kind)
            constants[name].CopyFrom(numpy_helper.from_array(value, name))
            names[node.output[0]] = name
        else:
            node.input[:] = [names.get(given, given) for given in node.input]
            nodes.append(node)
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)


def _smallest(value: np.ndarray) -> np.ndarray:
    """The value in the least precision that holds it."""
    with np.errstate(over="ignore"):
        for kind in (np.float16, np.float32):
            if np.array_equal(value.astype(kind).astype(value.dtype), value):
                return value.astype(kind)
    return value
