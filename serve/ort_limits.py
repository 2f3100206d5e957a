"""What a graph may ask for, read from model.ort before ONNX Runtime builds it: as graph_limits.py does of model.onnx.

The file is a FlatBuffer (ort.fbs of ONNX Runtime); the reader is the one that comes with ONNX Runtime.
"""

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np

from softslide.serve.graph_limits import (
    CONSTANT,
    INT64,
    MOST_SIZES,
    SIZE_INPUT,
    TREES,
    Constants,
    check_elements,
    check_nodes,
    check_operator,
    check_sizes,
    note,
)

_INLINE = -1


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
    check_nodes(graph.NodesLength())
    if graph.SparseInitializersLength():
        raise ValueError("a constant is sparse")
    constants: Constants = {}
    for n in range(graph.InitializersLength()):
        tensor = graph.Initializers(n)
        note(constants, tensor.Name(), _values(tensor))
    asked = []
    for n in range(graph.NodesLength()):
        node = graph.Nodes(n)
        operator = _text(node.OpType())
        check_operator(operator, _text(node.Domain()))
        for k in range(node.AttributesLength()):
            attribute = node.Attributes(k)
            if attribute.G() is not None or attribute.GraphsLength() or attribute.TensorsLength():
                raise ValueError(f"{operator} holds a graph or several constants")
            if operator != TREES:
                check_elements(operator, _first(attribute.Ints, attribute.IntsLength()))
            check_elements(operator, [attribute.I()])
            if attribute.T() is not None:
                values = _values(attribute.T())
                if operator == CONSTANT and node.OutputsLength():
                    note(constants, node.Outputs(0), values)
        place = SIZE_INPUT.get(operator)
        if place is not None:
            asked.append((operator, node.Inputs(place) if node.InputsLength() > place else b""))
    check_sizes(asked, constants)


def _values(tensor: Any) -> list[int] | None:
    """The values of a short list of int64, else none."""
    if tensor.ExternalDataOffset() != _INLINE:
        raise ValueError("a constant lies in another file")
    length = tensor.RawDataLength()
    dims = _first(tensor.Dims, tensor.DimsLength())
    if 0 not in dims:
        check_elements("a constant", dims, 2 * length + tensor.StringDataLength())
    if tensor.DataType() != INT64 or length > 8 * MOST_SIZES:
        return None
    return np.frombuffer(bytes(_first(tensor.RawData, length)), "<i8").tolist()


def _first(item: Callable[[int], int], count: int) -> list[int]:
    """The items of a vector; of many the first."""
    return [item(n) for n in range(min(count, 8 * MOST_SIZES + 1))]


def _text(name: bytes | None) -> str:
    return (name or b"").decode()
