"""ONNX operators as loops, by name."""

from collections.abc import Callable

import numpy as np
from onnx import helper

from softslide.models.export.c99 import products, views
from softslide.models.export.c99.loops import Nest
from softslide.models.export.c99.memory import Statement
from softslide.models.export.c99.node import Done, Node, NoForm
from softslide.models.export.c99.tensors import constant, scratch
from softslide.models.export.c99.trees import TreeSum, tree_tables

# An entry of the output from the entries of the inputs.
FORMULAS = {
    "Abs": "fabs{f}({0})",
    "And": "{0} && {1}",
    "Add": "{0} + {1}",
    "Cos": "cos{f}({0})",
    "Div": "{0} / {1}",
    "Equal": "{0} == {1}",
    "Exp": "exp{f}({0})",
    "Floor": "floor{f}({0})",
    "Greater": "{0} > {1}",
    "GreaterOrEqual": "{0} >= {1}",
    "Less": "{0} < {1}",
    "LessOrEqual": "{0} <= {1}",
    "Log": "log{f}({0})",
    "Mul": "{0} * {1}",
    "Neg": "-{0}",
    "Not": "!{0}",
    "Or": "{0} || {1}",
    "Pow": "pow{f}({0}, {1})",
    "Reciprocal": "1 / {0}",
    "Relu": "{0} < 0 ? 0 : {0}",
    "Sigmoid": "1 / (1 + exp{f}(-{0}))",
    "Sign": "({0} > 0) - ({0} < 0)",
    "Sin": "sin{f}({0})",
    "Sqrt": "sqrt{f}({0})",
    "Sub": "{0} - {1}",
    "Tanh": "tanh{f}({0})",
    "Where": "{0} ? {1} : {2}",
}
# To whole numbers: C leaves open what becomes of NaN and of what is beyond them.
WHOLE_NUMBERS = {
    "int32": "(int32_t)fmin(fmax({0}, -2147483647), 2147483647)",
    "int64": "(int64_t)fmin(fmax({0}, -9e15), 9e15)",
}
LOGICAL = ("And", "Equal", "Greater", "GreaterOrEqual", "Less", "LessOrEqual", "Not", "Or")
# Of two inputs, for operators that take any number. What is no number goes through.
PAIRED = {
    "Max": "{0} < {1} || isnan({1}) ? {1} : {0}",
    "Min": "{0} > {1} || isnan({1}) ? {1} : {0}",
    "Sum": "{0} + {1}",
}
# Start, update and end of a total over {n} entries.
TOTALS = {
    "ReduceMax": ("-INFINITY", "s = s < {0} ? {0} : s;", "s"),
    "ReduceMean": ("0", "s += {0};", "s / {n}"),
    "ReduceMin": ("INFINITY", "s = s > {0} ? {0} : s;", "s"),
    "ReduceSum": ("0", "s += {0};", "s"),
    "ReduceSumSquare": ("0", "s += {0} * {0};", "s"),
}
# What they give is settled with the shapes.
SETTLED = ("Shape", "Size")


def lowered(node: Node) -> Done:
    """The node as loops; without any where it is constant or only moves data.

    Raises:
        NoForm: the operator, or this use of it, is not covered.
    """
    if node.kind in SETTLED:
        return [], [constant(node.run(node.tensor(0).index)[0])]
    if all(tensor is None or tensor.value is not None for tensor in node.inputs):
        given = (None if tensor is None else tensor.value for tensor in node.inputs)
        return [], [constant(np.asarray(value)) for value in node.run(*given)]
    for kinds, function in (
        (views.MOVES, views.moved),
        (FORMULAS, _formula),
        (PAIRED, _paired),
        (TOTALS, _total),
    ):
        if node.kind in kinds:
            return function(node)
    if node.kind in OPERATORS:
        return OPERATORS[node.kind](node)
    raise NoForm(f"operator {node.kind}")


def _formula(node: Node) -> Done:
    operands = tuple(node.tensor(n) for n in range(len(node.inputs)))
    kind = operands[1 if node.kind == "Where" else 0].kind
    if node.kind in LOGICAL:
        kind = np.dtype(bool)
    out = scratch(np.broadcast_shapes(*(operand.shape for operand in operands)), kind)
    return [Nest(node.kind, out, operands, FORMULAS[node.kind])], [out]


def _cast(node: Node) -> Done:
    given = node.tensor(0)
    kind = helper.tensor_dtype_to_np_dtype(node.attributes["to"])
    if kind == given.kind:
        return [], [given]
    if kind.name not in ("float32", "float64", *WHOLE_NUMBERS):
        raise NoForm(f"operator Cast to {kind}")
    out = scratch(given.shape, kind)
    return [Nest("Cast", out, (given,), WHOLE_NUMBERS.get(kind.name, "{0}"))], [out]


def _paired(node: Node) -> Done:
    held = node.tensor(0)
    steps: list[Statement] = []
    for n in range(1, len(node.inputs)):
        other = node.tensor(n)
        out = scratch(np.broadcast_shapes(held.shape, other.shape), held.kind)
        steps.append(Nest(node.kind, out, (held, other), PAIRED[node.kind]))
        held = out
    return steps, [held]


def _total(node: Node) -> Done:
    given = node.tensor(0)
    rank = given.index.ndim
    axes = node.argument(1, node.attributes.get("axes", []))
    if not len(axes):
        if node.attributes.get("noop_with_empty_axes"):
            return [], [given]
        axes = range(rank)
    gone = sorted(int(axis) % rank for axis in axes)
    kept = [axis for axis in range(rank) if axis not in gone]
    inner = tuple(given.shape[axis] for axis in gone)
    out = scratch(tuple(given.shape[axis] for axis in kept), given.kind)
    start, update, finish = TOTALS[node.kind]
    finish = finish.replace("{n}", str(int(np.prod(inner))))
    turned = given.seen(given.index.transpose(kept + gone))
    shown = out.seen(np.expand_dims(out.index, gone)) if node.attributes.get("keepdims", 1) else out
    return [Nest(node.kind, out, (turned,), finish, inner, start, update)], [shown]


def _clip(node: Node) -> Done:
    given = node.tensor(0)
    # A bound that is missing is the value itself, which it never cuts.
    low, high = (given if bound is None else bound for bound in (*node.inputs[1:], None, None)[:2])
    out = scratch(given.shape, given.kind)
    return [Nest("Clip", out, (given, low, high), "{0} < {1} ? {1} : {0} > {2} ? {2} : {0}")], [out]


def _trees(node: Node) -> Done:
    try:
        tables = tree_tables(node.attributes)
    except ValueError as error:
        raise NoForm(f"operator {node.kind} with {error}") from None
    out = scratch((1, tables.targets), np.dtype(np.float32))
    return [TreeSum(out, node.tensor(0), tables)], [out]


OPERATORS: dict[str, Callable[[Node], Done]] = {
    "Cast": _cast,
    "Clip": _clip,
    "Concat": views.concat,
    "Conv": products.conv,
    "Gemm": products.gemm,
    "MatMul": products.matmul,
    "Pad": views.pad,
    "TreeEnsembleRegressor": _trees,
}
