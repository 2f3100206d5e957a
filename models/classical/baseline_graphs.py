"""Graphs of the regressors on features: `features` (B, F) float32 -> `estimate` (B, 4) float32.

The forests go through skl2onnx, which is exact for them. It returns another shape for a network with several targets
and loses a Gaussian process's digits in float32, so these two are written here, in float64.
"""

import numpy as np
import onnx
from onnx import TensorProto
from skl2onnx import convert_sklearn
from skl2onnx.common.data_types import FloatTensorType

from models.classical.baselines import FORESTS, OUTPUTS, GaussianProcess, Perceptrons, Scale, Trees
from models.graph.builder import OPSET, OPSET_ML, GraphBuilder


def trees_graph(trees: Trees, features: int) -> onnx.ModelProto:
    """One ensemble node a forest, their columns put back in order."""
    g = GraphBuilder()
    read = g.columns("features", trees.columns)
    parts = []
    for (grown, taken), forest in zip(FORESTS, trees.forests, strict=True):
        (node,) = _ensemble(forest, len(trees.columns)).graph.node
        out = g.name()
        node.input[0], node.output[0], node.name = read, out, out
        g.nodes.append(node)
        parts.append(g.columns(out, np.array([grown.index(k) for k in taken])))
    order = np.argsort(np.concatenate([taken for _, taken in FORESTS]))
    standard = g.columns(g.op("Concat", *parts, axis=1), order)
    return g.model(_natural(g, g.cast(standard, TensorProto.DOUBLE), trees.target), features, len(OUTPUTS))


def mlp_graph(networks: Perceptrons, features: int) -> onnx.ModelProto:
    """Members side by side, then their mean."""
    g = GraphBuilder()
    standard = _standard(g, networks.columns, networks.input)
    rows = []
    for member in networks.members:
        value = standard
        for layer, (weight, bias) in enumerate(zip(member.coefs_, member.intercepts_, strict=True)):
            value = g.op("Add", g.op("MatMul", value, g.constant(weight)), g.constant(bias))
            if layer < len(member.coefs_) - 1:
                value = g.op("Tanh", value)
        rows.append(value)
    mean = g.op("Mul", g.op("Sum", *rows), g.constant(1.0 / len(rows)))
    return g.model(_natural(g, mean, networks.target), features, len(OUTPUTS))


def gp_graph(process: GaussianProcess, features: int) -> onnx.ModelProto:
    """|x - x_i|^2 as |x|^2 - 2 x . x_i + |x_i|^2, all points at once."""
    g = GraphBuilder()
    standard = _standard(g, process.columns, process.input)
    own = g.total(g.op("Mul", standard, standard), 1, keep=True)
    product = g.op("MatMul", standard, g.constant(-2.0 * process.points.T))
    square = g.op("Add", g.op("Add", product, own), g.constant(np.square(process.points).sum(axis=1)))
    means = []
    for k in process.kernels:
        kernel = g.op("Exp", g.op("Mul", square, g.constant(-0.5 / k.length**2)))
        means.append(g.op("MatMul", kernel, g.constant(k.amplitude * k.weights[:, None])))
    standard_row = g.op("Concat", *means, axis=1)
    return g.model(_natural(g, standard_row, process.target), features, len(OUTPUTS))


def _ensemble(forest: object, columns: int) -> onnx.ModelProto:
    kind = FloatTensorType([None, columns])
    return convert_sklearn(
        forest, initial_types=[("x", kind)], target_opset={"": OPSET, "ai.onnx.ml": OPSET_ML}
    )


def _standard(g: GraphBuilder, columns: np.ndarray, scale: Scale) -> str:
    read = g.cast(g.columns("features", columns), TensorProto.DOUBLE)
    return g.op("Div", g.op("Sub", read, g.constant(scale.mean)), g.constant(scale.deviation))


def _natural(g: GraphBuilder, standard: str, scale: Scale) -> str:
    return g.op("Add", g.op("Mul", standard, g.constant(scale.deviation)), g.constant(scale.mean))
