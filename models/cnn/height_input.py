"""The skin's height as a number that a graph is given, and need not be.

The table of the response map in the graph is that of one height. Next to it stands what it changes by with height,
times an initializer that is an input too: a run that does not name it takes the map's own height (ONNX, overridable
initializers). It costs one small product a run.
"""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from softslide.features.contact.response_surface import PARTS
from softslide.features.height import HEIGHT_INPUT
from softslide.models.cnn.forward_model import TABLE, patch_table
from softslide.models.graph.packing import pack, rounded, unpack
from softslide.models.response_map.map import ResponseMap

# Constants of the graph: (cells, C) V/mm, the change of the table's M with height; (C, 4 C), where it is in a row, in
# which the PARTS of a channel lie side by side.
SLOPE = "refinement.predicted.height_slope"
_PLACES = "refinement.predicted.height_places"
_AT_HEIGHT = "table_at_height"


def with_height(graph: onnx.ModelProto, response: ResponseMap) -> onnx.ModelProto:
    """The graph with the input HEIGHT_INPUT, (1,) float32, the skin's height less the map's in mm; 0 unless given."""
    import torch

    assert response.height_slope is not None
    table, _ = patch_table(response.height_slope[None])
    slope = rounded(torch.tensor(table, dtype=torch.float32)).numpy()
    places = np.zeros((response.channels, PARTS * response.channels), np.float32)
    places[np.arange(response.channels), PARTS * np.arange(response.channels)] = 1.0
    given = onnx.ModelProto()
    given.CopyFrom(graph)
    unpack(given)
    for node in given.graph.node:
        node.input[:] = [_AT_HEIGHT if name == TABLE else name for name in node.input]
    constants = {SLOPE: slope, _PLACES: places, HEIGHT_INPUT: np.zeros(1, np.float32)}
    given.graph.initializer.extend(numpy_helper.from_array(value, name) for name, value in constants.items())
    given.graph.input.append(helper.make_tensor_value_info(HEIGHT_INPUT, TensorProto.FLOAT, [1]))
    nodes = [
        helper.make_node("Mul", [_PLACES, HEIGHT_INPUT], ["height_part"]),
        helper.make_node("MatMul", [SLOPE, "height_part"], ["height_change"]),
        helper.make_node("Add", [TABLE, "height_change"], [_AT_HEIGHT]),
        *given.graph.node,
    ]
    del given.graph.node[:]
    given.graph.node.extend(nodes)
    pack(given)
    onnx.checker.check_model(given, full_check=True)
    return given
