"""What a graph may ask for, read from model.ort before ONNX Runtime builds it: as graph_limits.py does of model.onnx.

The file is a FlatBuffer (ort.fbs of ONNX Runtime); the reader is the one that comes with ONNX Runtime.
"""

import importlib
from typing import Any

import numpy as np

from softslide.serve.graph_limits import (
    INT64,
    MOST_BYTES,
    MOST_NODES,
    SHAPE_INPUT,
    SHORT_BYTES,
    check_domain,
    check_sizes,
)

_CONSTANT, _INLINE = "Constant", -1


def check_ort(graph: bytes) -> None:
    """Checks a model.ort.

    Raises:
        ValueError: as `graph_limits.check_onnx`, or this ONNX Runtime comes without a reader of the format.
    """
    try:
        # Puts its folder of generated readers on the path.
        importlib.import_module("onnxruntime.tools.ort_format_model")
        readers = importlib.import_module("ort_flatbuffers_py.fbs.InferenceSession")
    except ImportError:
        raise ValueError("this ONNX Runtime has no reader of its own format; use model.onnx") from None
    session = readers.InferenceSession
    if not session.InferenceSessionBufferHasIdentifier(graph, 0):
        raise ValueError("not in the ORT format")
    _check_graph(session.GetRootAs(graph).Model().Graph())


def _check_graph(graph: Any) -> None:
    if graph.NodesLength() > MOST_NODES:
        raise ValueError(f"more than {MOST_NODES} nodes")
    if graph.SparseInitializersLength():
        raise ValueError("a constant is sparse")
    constants: dict[bytes, list[int]] = {}
    for n in range(graph.InitializersLength()):
        tensor = graph.Initializers(n)
        constants[tensor.Name()] = _values(tensor)
    asked = []
    for n in range(graph.NodesLength()):
        node = graph.Nodes(n)
        operator = _text(node.OpType())
        check_domain(operator, _text(node.Domain()))
        for k in range(node.AttributesLength()):
            attribute = node.Attributes(k)
            if attribute.G() is not None or attribute.GraphsLength():
                raise ValueError(f"control flow, operator {operator}")
            if attribute.T() is not None and operator == _CONSTANT:
                constants[node.Outputs(0)] = _values(attribute.T())
        place = SHAPE_INPUT.get(operator)
        if place is not None and node.InputsLength() > place:
            asked.append((operator, node.Inputs(place)))
    check_sizes(asked, constants)


def _values(tensor: Any) -> list[int]:
    """The values of a short list of int64, else none."""
    dims = [tensor.Dims(n) for n in range(min(tensor.DimsLength(), MOST_NODES))]
    if tensor.ExternalDataOffset() != _INLINE:
        raise ValueError("a constant lies in another file")
    if any(size < 0 for size in dims) or np.prod([1.0, *dims]) > MOST_BYTES:
        raise ValueError("a constant is too large")
    length = tensor.RawDataLength()
    if tensor.DataType() != INT64 or length > SHORT_BYTES or length % 8:
        return []
    raw = bytes(tensor.RawData(n) for n in range(length))
    return np.frombuffer(raw, "<i8").tolist()


def _text(name: bytes | None) -> str:
    return (name or b"").decode()
