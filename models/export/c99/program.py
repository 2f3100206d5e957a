"""From a graph to the steps of one C function: one window at a time, every size known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import onnx
from onnx import helper
from onnx.reference import ReferenceEvaluator

from softslide.models.export.c99.loops import Nest
from softslide.models.export.c99.memory import Statement
from softslide.models.export.c99.node import Node
from softslide.models.export.c99.operators import lowered
from softslide.models.export.c99.tensors import Buffer, Tensor, constant, whole


@dataclass(frozen=True)
class Program:
    """inputs: the function's parameters, tensors with a batch of 1 by name; output: the last one, named `estimate`."""

    inputs: dict[str, Tensor]
    output: Tensor
    statements: Sequence[Statement]


def program(model: onnx.ModelProto) -> Program:
    """The graph with a batch of one window as steps, constants worked out.

    Raises:
        NoForm: an operator, or a use of one, that has no form in C.
    """
    graph = model.graph
    # Of each operator only its own reference is run, on constants, shapes and places: never a whole graph.
    evaluator = ReferenceEvaluator(model)
    # What need not be given is as it is unless it is given: a constant.
    inputs = {v.name: _parameter(v) for v in graph.input if v.name not in evaluator.rt_inits_}
    known: dict[str, Tensor] = {
        name: constant(np.asarray(value)) for name, value in evaluator.rt_inits_.items()
    }
    known |= inputs
    statements: list[Statement] = []
    with np.errstate(all="ignore"):
        for proto, reference in zip(graph.node, evaluator.rt_nodes_, strict=True):
            attributes = {a.name: helper.get_attribute_value(a) for a in proto.attribute}
            given = [known[name] if name else None for name in proto.input]
            steps, found = lowered(Node(proto.op_type, given, attributes, reference.run))
            statements += steps
            known |= dict(zip(proto.output, found, strict=False))
    (last,) = (known[value.name] for value in graph.output)
    output = whole(Buffer(np.dtype(np.float32), last.index.size, "estimate"), last.shape)
    statements.append(Nest("output", output, (last,), "{0}"))
    return Program(inputs, output, _needed(statements, output.buffer))


def _parameter(value: onnx.ValueInfoProto) -> Tensor:
    shape = tuple(d.dim_value or 1 for d in value.type.tensor_type.shape.dim)
    kind = helper.tensor_dtype_to_np_dtype(value.type.tensor_type.elem_type)
    return whole(Buffer(kind, int(np.prod(shape, dtype=int)), value.name), shape)


def _needed(statements: list[Statement], output: Buffer) -> list[Statement]:
    """Without those whose results nobody reads."""
    wanted = {output}
    kept = []
    for statement in reversed(statements):
        if statement.writes in wanted:
            wanted.update(statement.reads)
            kept.append(statement)
    return kept[::-1]
