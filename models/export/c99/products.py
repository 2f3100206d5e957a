"""Operators that are sums of products: loops over the output, and inside them over what is summed."""

import numpy as np

from softslide.models.export.c99.loops import Nest
from softslide.models.export.c99.node import Done, Node, NoForm
from softslide.models.export.c99.tensors import scratch
from softslide.models.export.c99.views import padded

_START, _UPDATE = "0", "s += {0} * {1};"


def matmul(node: Node) -> Done:
    """(..., m, k) (..., k, n) -> (..., m, n)."""
    a, b = node.tensor(0), node.tensor(1)
    if a.index.ndim < 2 or b.index.ndim < 2:
        raise NoForm("operator MatMul with a vector")
    rows, columns = a.index[..., :, None, :], b.index.swapaxes(-1, -2)[..., None, :, :]
    *shape, inner = np.broadcast_shapes(rows.shape, columns.shape)
    out = scratch(tuple(shape), a.kind)
    return [Nest("MatMul", out, (a.seen(rows), b.seen(columns)), "s", (inner,), _START, _UPDATE)], [out]


def gemm(node: Node) -> Done:
    """alpha a b + beta c."""
    a, b = node.tensor(0), node.tensor(1)
    rows = a.index.T if node.attributes.get("transA") else a.index
    columns = b.index if node.attributes.get("transB") else b.index.T
    out = scratch((len(rows), len(columns)), a.kind)
    operands = [a.seen(rows[:, None]), b.seen(columns[None])]
    finish = _times(node.attributes.get("alpha", 1.0), "s")
    if len(node.inputs) > 2:
        c = node.tensor(2)
        operands.append(c.seen(c.index[..., None]))
        finish += " + " + _times(node.attributes.get("beta", 1.0), "{2}")
    return [Nest("Gemm", out, tuple(operands), finish, rows.shape[1:], _START, _UPDATE)], [out]


def _times(factor: float, entry: str) -> str:
    return entry if factor == 1 else f"({factor!r}) * {entry}"


def conv(node: Node) -> Done:
    """The kernel times a sliding view of the padded input."""
    x, w = node.tensor(0), node.tensor(1)
    size = w.shape[2:]
    axes = len(size)
    if node.attributes.get("group", 1) != 1 or node.attributes.get("auto_pad", b"NOTSET") != b"NOTSET":
        raise NoForm("operator Conv with groups or automatic padding")
    pads = np.zeros((2, 2 + axes), int)
    pads[:, 2:] = np.reshape(node.attributes.get("pads", pads[:, 2:]), (2, axes))
    steps, wide = padded("Conv", x, pads, 0.0)
    spread = node.attributes.get("dilations", [1] * axes)
    reach = [(k - 1) * d + 1 for k, d in zip(size, spread, strict=True)]
    # (1, 1, places of the kernel, 1, channels, kernel), places and kernel an axis each.
    view = np.lib.stride_tricks.sliding_window_view(wide.index, (1, x.shape[1], *reach))
    paces = (1, 1, *node.attributes.get("strides", [1] * axes), 1, 1, *spread)
    view = view[tuple(slice(None, None, pace) for pace in paces)].squeeze(2 + axes)
    kernel = w.index.reshape(1, w.shape[0], *(1,) * axes, *w.shape[1:])
    out = scratch((1, w.shape[0], *view.shape[2 : 2 + axes]), x.kind)
    operands = [wide.seen(view), w.seen(kernel)]
    finish = "s"
    if len(node.inputs) > 2:
        bias = node.tensor(2)
        operands.append(bias.seen(bias.index.reshape(-1, *(1,) * (2 * axes + 1))))
        finish = "s + {2}"
    return [*steps, Nest("Conv", out, tuple(operands), finish, w.shape[1:], _START, _UPDATE)], [out]
