"""Operators that only put entries elsewhere: read by another index where even steps describe it, else copied."""

import numpy as np

from softslide.models.export.c99.loops import Nest, strides
from softslide.models.export.c99.memory import Statement
from softslide.models.export.c99.node import Done, Node, NoForm
from softslide.models.export.c99.tensors import Tensor, constant, scratch

MOVES = (
    "Expand",
    "Flatten",
    "Gather",
    "GatherND",
    "Identity",
    "Reshape",
    "Slice",
    "Split",
    "Squeeze",
    "Tile",
    "Transpose",
    "Unsqueeze",
)


def moved(node: Node) -> Done:
    """Where the operator's own reference puts the places of the entries, their values go too."""
    data = node.tensor(0)
    if node.kind == "Gather" and node.tensor(1).value is None:
        return _gathered(data, node.tensor(1), node.attributes.get("axis", 0))
    arguments = [node.argument(n) for n in range(1, len(node.inputs))]
    steps: list[Statement] = []
    found = []
    for index in node.run(data.index, *arguments):
        try:
            strides(index)
            found.append(data.seen(index))
        except ValueError:
            out = scratch(index.shape, data.kind)
            table = constant(index.astype(np.min_scalar_type(-int(index.max()) - 1)))
            start = data.seen(np.zeros((), int))
            steps.append(Nest(node.kind, out, (start, table), "{0}", step=1, size=data.buffer.size))
            found.append(out)
    return steps, found


def _gathered(data: Tensor, which: Tensor, axis: int) -> Done:
    """Entries at computed places along an axis."""
    axis %= data.index.ndim
    _, paces = strides(data.index)
    before, after = data.shape[:axis], data.shape[axis + 1 :]
    out = scratch(before + which.shape + after, data.kind)
    start = np.expand_dims(data.index.take(0, axis), tuple(range(axis, axis + which.index.ndim)))
    places = which.index.reshape(which.shape + (1,) * len(after))
    operands = (data.seen(start), which.seen(places))
    return [Nest("Gather", out, operands, "{0}", step=paces[axis], size=data.shape[axis])], [out]


def concat(node: Node) -> Done:
    """A copy of each part."""
    parts = [node.tensor(n) for n in range(len(node.inputs))]
    axis = node.attributes["axis"] % parts[0].index.ndim
    ends = np.cumsum([part.shape[axis] for part in parts])
    shape = [*parts[0].shape]
    shape[axis] = int(ends[-1])
    out = scratch(tuple(shape), parts[0].kind)
    pieces = zip(np.split(out.index, ends[:-1], axis), parts, strict=True)
    return [Nest("Concat", out.seen(index), (part,), "{0}") for index, part in pieces], [out]


def pad(node: Node) -> Done:
    """Constant padding."""
    x = node.tensor(0)
    amounts = np.zeros((2, x.index.ndim), int)
    amounts[:, node.argument(3, np.arange(x.index.ndim))] = node.argument(1).reshape(2, -1)
    if node.attributes.get("mode", b"constant") != b"constant" or (amounts < 0).any():
        raise NoForm("operator Pad that cuts or repeats")
    steps, out = padded("Pad", x, amounts, node.argument(2, 0))
    return steps, [out]


def padded(kind: str, x: Tensor, amounts: np.ndarray, fill: float) -> tuple[list[Statement], Tensor]:
    """amounts (2, axes): entries to add before each axis, and after."""
    if not amounts.any():
        return [], x
    before = amounts[0]
    out = scratch(tuple(int(n) for n in np.array(x.shape) + amounts.sum(axis=0)), x.kind)
    middle = tuple(slice(b, b + n) for b, n in zip(before, x.shape, strict=True))
    filled = Nest(kind, out, (constant(np.array(fill, x.kind)),), "{0}")
    return [filled, Nest(kind, out.seen(out.index[middle]), (x,), "{0}")], out
