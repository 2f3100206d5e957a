"""Large constants of a graph in as few bytes as hold them to the last bit: a third of a bundle, all precision at work.

Nothing is rounded, so that the graph computes the same; a model that wants to be small rounds its constants first
(`rounded`, `rounded_weights`). ONNX Runtime undoes casts and products once, as it loads the graph.
"""

import numpy as np
import onnx
import torch
from onnx import helper, numpy_helper

# Numbers in a constant; below this a cast takes as many bytes as it saves.
LEAST = 128
_WHOLE = "_"  # ends the name of what a cast gives
# End the names of a row's whole numbers as they are cast, and of their steps.
_BYTES, _STEPS = "_bytes", "_steps"
_MOST_STEPS = 127  # of a row's largest value: whole numbers of 8 bits


def rounded(values: torch.Tensor) -> torch.Tensor:
    """float32 values as half precision holds them (11 bits)."""
    return values.half().float()


def rounded_weights(values: torch.Tensor) -> torch.Tensor:
    """float32 weights (n, ...) in 8 bits: whole numbers times a step of each row, itself in half precision.

    Of a network whose proposals are refined it costs nothing (experiments/LOG.md).
    """
    largest = values.flatten(1).abs().amax(1)
    steps = rounded(largest / _MOST_STEPS).reshape(-1, *[1] * (values.dim() - 1))
    whole = torch.round(values / torch.where(steps > 0, steps, 1.0)).clamp(-_MOST_STEPS, _MOST_STEPS)
    return whole * steps


def pack(graph: onnx.ModelProto) -> None:
    """Stores the graph's large constants in 8 bits and a step a row, or in half or single precision, where that is
    exact, each with what undoes it in front of what reads it."""
    casts = []
    for item in list(graph.graph.initializer):
        value = numpy_helper.to_array(item)
        if value.dtype not in (np.float32, np.float64) or value.size < LEAST:
            continue
        name, kind = item.name, item.data_type
        if (in_bytes := _in_bytes(value)) is not None:
            whole, steps = in_bytes
            item.CopyFrom(numpy_helper.from_array(whole, name))
            graph.graph.initializer.append(numpy_helper.from_array(steps, name + _STEPS))
            casts.append(helper.make_node("Cast", [name], [name + _BYTES], to=kind))
            casts.append(helper.make_node("Mul", [name + _BYTES, name + _STEPS], [name + _WHOLE]))
        else:
            packed = _smallest(value)
            if packed.dtype == value.dtype:
                continue
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
        if node.op_type == "Cast" and name in constants and node.output[0] == name + _BYTES:
            steps = constants[name + _STEPS]
            value = numpy_helper.to_array(constants[name]) * numpy_helper.to_array(steps)
            constants[name].CopyFrom(numpy_helper.from_array(value, name))
            graph.graph.initializer.remove(steps)
        elif node.op_type == "Mul" and name.endswith(_BYTES) and node.output[0].endswith(_WHOLE):
            names[node.output[0]] = name.removesuffix(_BYTES)
        elif node.op_type == "Cast" and name in constants and node.output[0] == name + _WHOLE:
            kind = helper.tensor_dtype_to_np_dtype(node.attribute[0].i)
            value = numpy_helper.to_array(constants[name]).astype(kind)
            constants[name].CopyFrom(numpy_helper.from_array(value, name))
            names[node.output[0]] = name
        else:
            node.input[:] = [names.get(given, given) for given in node.input]
            nodes.append(node)
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)


def _in_bytes(value: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """float32 rows as whole numbers of 8 bits and a step each (n, 1, ...); None where that is not exact."""
    if value.dtype != np.float32 or value.ndim < 2 or not np.isfinite(value).all():
        return None
    largest = np.abs(value).reshape(len(value), -1).max(axis=1).reshape(-1, *[1] * (value.ndim - 1))
    steps = np.where(largest > 0, largest, 1).astype(np.float32) / np.float32(_MOST_STEPS)
    whole = np.round(value / steps).astype(np.int8)
    return (whole, steps) if np.array_equal(whole * steps, value) else None


def _smallest(value: np.ndarray) -> np.ndarray:
    """The value in the least precision that holds it."""
    with np.errstate(over="ignore"):
        for kind in (np.float16, np.float32):
            if np.array_equal(value.astype(kind).astype(value.dtype), value):
                return value.astype(kind)
    return value
