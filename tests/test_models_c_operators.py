"""Each operator that has a form in C computes what ONNX Runtime does."""

from collections.abc import Callable

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from c_case import NEEDS_COMPILER, Case, any_card, difference
from onnx import TensorProto

from softslide.features.card import Card
from softslide.models.export.c99.node import NoForm
from softslide.models.export.c99.source import sources
from softslide.models.graph.builder import OPSET, GraphBuilder

pytestmark = NEEDS_COMPILER


@pytest.fixture(scope="module")
def card(tmp_path_factory: pytest.TempPathFactory) -> Card:
    return any_card(tmp_path_factory.mktemp("bundle"))


def ints(g: GraphBuilder, *values: int) -> str:
    return g.constant(values, np.int64)


def randoms(g: GraphBuilder, *shape: int) -> str:
    return g.constant(np.random.default_rng(5).normal(size=shape).astype(np.float32), np.float32)


def truth(g: GraphBuilder, value: str) -> str:
    return g.cast(value, TensorProto.FLOAT)


def double(g: GraphBuilder, value: str) -> str:
    return g.cast(value, TensorProto.DOUBLE)


def whole(g: GraphBuilder, x: str) -> str:
    """0 or 1, or counted from the end."""
    low, high = (g.constant(bound, np.float32) for bound in (-2.0, 1.0))
    return g.cast(g.op("Clip", g.op("Floor", x), low, high), TensorProto.INT64)


def bright(g: GraphBuilder, x: str) -> str:
    """Which entries are above 0.3."""
    return g.op("Greater", x, g.constant(0.3, np.float32))


def unreal(g: GraphBuilder, x: str) -> str:
    """NaN where an entry is below 0."""
    return g.op("Sqrt", x)


IN_DOUBLES = ("Abs", "Cos", "Exp", "Log", "Neg", "Reciprocal", "Sin", "Sqrt", "Tanh")
# Each takes x (1, 2, 3, 4), uneven numbers about 0, and gives a value of any shape.
OPERATORS: dict[str, Callable[[GraphBuilder, str], str]] = {
    **{kind: lambda g, x, kind=kind: g.op(kind, x) for kind in (*IN_DOUBLES, "Relu", "Sigmoid", "Sign")},
    **{f"{kind} in doubles": lambda g, x, kind=kind: g.op(kind, double(g, x)) for kind in IN_DOUBLES},
    **{
        f"{kind} along axis {axis}": lambda g, x, kind=kind, axis=axis: g.op(
            kind, x, ints(g, axis), keepdims=axis % 2
        )
        for kind in ("ReduceMax", "ReduceMean", "ReduceMin", "ReduceSum", "ReduceSumSquare")
        for axis in (1, -2, 3)
    },
    **{
        f"{kind} against a row": lambda g, x, kind=kind: g.op(kind, x, randoms(g, 4))
        for kind in ("Add", "Div", "Max", "Min", "Mul", "Sub")
    },
    **{
        f"{kind} against a column": lambda g, x, kind=kind: truth(g, g.op(kind, x, randoms(g, 3, 1)))
        for kind in ("Greater", "GreaterOrEqual", "Less", "LessOrEqual")
    },
    "Equal": lambda g, x: truth(g, g.op("Equal", g.op("Relu", x), g.constant(0.0, np.float32))),
    "And, Or, Not": lambda g, x: truth(
        g, g.op("And", g.op("Not", bright(g, x)), g.op("Or", bright(g, x), bright(g, g.op("Neg", x))))
    ),
    "Where": lambda g, x: g.op("Where", bright(g, x), x, randoms(g, 2, 1, 4)),
    "Pow": lambda g, x: g.op("Pow", x, g.constant(3.0, np.float32)),
    "Clip": lambda g, x: g.op("Clip", x, g.constant(-0.2, np.float32), g.constant(0.4, np.float32)),
    "Clip below": lambda g, x: g.op("Clip", x, g.constant(-0.2, np.float32)),
    "Clip above": lambda g, x: g.op("Clip", x, "", g.constant(0.4, np.float32)),
    "Clip of no number": lambda g, x: g.op("Clip", unreal(g, x), g.constant(-0.2, np.float32)),
    "Max of no number": lambda g, x: g.op("Max", unreal(g, x), x),
    "Max with no number": lambda g, x: g.op("Max", x, unreal(g, x)),
    "Sum of three": lambda g, x: g.op("Sum", x, randoms(g, 3, 1), randoms(g, 4)),
    "ReduceSum of all": lambda g, x: g.op("ReduceSum", x),
    "ReduceMean of two axes": lambda g, x: g.op("ReduceMean", double(g, x), ints(g, 1, 3)),
    "Transpose": lambda g, x: g.op("Transpose", x, perm=[0, 3, 1, 2]),
    "Transpose, then Reshape": lambda g, x: g.op(
        "Reshape", g.op("Transpose", x, perm=[0, 3, 1, 2]), ints(g, 6, 4)
    ),
    "Slice backwards": lambda g, x: g.op(
        "Slice", x, ints(g, 3, 1), ints(g, -99, 3), ints(g, 3, 2), ints(g, -2, 1)
    ),
    "Gather a column": lambda g, x: g.op("Gather", x, g.constant(2, np.int64), axis=3),
    "Gather in disorder": lambda g, x: g.op("Gather", x, ints(g, 3, 0, 0, 2, 1), axis=3),
    "Gather at computed places": lambda g, x: g.op("Gather", randoms(g, 2, 5, 3), whole(g, x), axis=1),
    "Gather of what is computed": lambda g, x: g.op(
        "Gather", g.op("Transpose", x, perm=[0, 3, 2, 1]), whole(g, g.op("Reshape", x, ints(g, 24))), axis=-1
    ),
    "GatherND": lambda g, x: g.op(
        "GatherND", g.op("Squeeze", x, ints(g, 0)), g.constant([[1, 0], [0, 2]], np.int64)
    ),
    "Expand": lambda g, x: g.op("Expand", g.op("Unsqueeze", x, ints(g, 2)), ints(g, 1, 2, 5, 3, 4)),
    "Concat": lambda g, x: g.op("Concat", x, randoms(g, 1, 2, 3, 2), x, axis=-1),
    "Flatten": lambda g, x: g.op("Flatten", g.op("Transpose", x, perm=[0, 2, 1, 3]), axis=2),
    "Tile": lambda g, x: g.op("Tile", x, ints(g, 1, 2, 1, 3)),
    "Pad": lambda g, x: g.op("Pad", x, ints(g, 0, 1, 0, 2, 0, 0, 1, 3), g.constant(0.7, np.float32)),
    "MatMul of many": lambda g, x: g.op("MatMul", x, g.op("Transpose", x, perm=[0, 1, 3, 2])),
    "MatMul, one for all": lambda g, x: g.op("MatMul", x, randoms(g, 4, 5)),
    "Gemm": lambda g, x: g.op(
        "Gemm",
        g.op("Reshape", x, ints(g, 4, 6)),
        randoms(g, 5, 4),
        randoms(g, 5),
        transA=1,
        transB=1,
        alpha=0.5,
    ),
    "Conv": lambda g, x: g.op(
        "Conv", x, randoms(g, 5, 2, 2, 3), randoms(g, 5), pads=[1, 0, 0, 2], strides=[1, 2], dilations=[2, 1]
    ),
    "Shape": lambda g, x: g.op("Expand", g.op("ReduceSum", x, ints(g, 3)), g.op("Shape", x)),
}


def graph_of(g: GraphBuilder, outputs: dict[str, int | None]) -> bytes:
    """`features` (B, 24) -> values (B, n) by name."""
    features, *values = (
        onnx.helper.make_tensor_value_info(name, TensorProto.FLOAT, ["B", n])
        for name, n in ({"features": 24} | outputs).items()
    )
    graph = onnx.helper.make_graph(g.nodes, "operators", [features], values, g.constants)
    opsets = [onnx.helper.make_opsetid("", OPSET)]
    return onnx.helper.make_model(graph, opset_imports=opsets, ir_version=10).SerializeToString()


@pytest.fixture(scope="module")
def of_operators(card: Card, tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """(2, entries) for each operator: C's and ONNX Runtime's, for two inputs, from one graph of them all."""
    g = GraphBuilder()
    x = g.op("Reshape", "features", ints(g, 1, 2, 3, 4))
    parts = [truth(g, g.op("Reshape", build(g, x), ints(g, 1, -1))) for build in OPERATORS.values()]
    session = ort.InferenceSession(graph_of(g, dict.fromkeys(parts)), providers=["CPUExecutionProvider"])
    x = np.random.default_rng(0).normal(0.0, 1.0, (2, 24)).astype(np.float32)
    rows = [session.run(None, {"features": x[n : n + 1]}) for n in range(2)]
    wanted = np.concatenate([np.hstack(row) for row in rows])
    ends = np.cumsum([part.shape[1] for part in rows[0]])
    graph = graph_of(g, {g.op("Concat", *parts, axis=1): wanted.shape[1]})
    case = Case(onnx.load_model_from_string(graph), {"features": x})
    both = np.stack([case.c_rows(tmp_path_factory.mktemp("operators"), card), wanted])
    return dict(zip(OPERATORS, np.split(both, ends[:-1], 2), strict=True))


@pytest.mark.parametrize("name", OPERATORS)
def test_an_operator_is_onnx_runtimes(of_operators: dict[str, np.ndarray], name: str) -> None:
    ours, theirs = of_operators[name]
    assert difference(ours, theirs) < 1e-6


UNCOVERED: dict[str, Callable[[GraphBuilder], str]] = {
    "Softmax": lambda g: g.op("Softmax", "features"),
    "Expand": lambda g: g.op("Expand", "features", "features"),
    "Einsum": lambda g: g.op("Einsum", "features", "features", equation="bi,bi->b"),
}


@pytest.mark.parametrize("kind", UNCOVERED)
def test_an_operator_that_has_no_form_is_named(card: Card, kind: str) -> None:
    g = GraphBuilder()
    graph = onnx.load_model_from_string(graph_of(g, {UNCOVERED[kind](g): 24}))
    with pytest.raises(NoForm, match=kind):
        sources(graph, card)
