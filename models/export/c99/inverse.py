"""The inverse of a matrix, in its place: Gauss-Jordan with the largest pivot of each column."""

from dataclasses import dataclass

import numpy as np
from onnx.reference.op_run import OpRun

from models.export.c99.loops import Nest, Place
from models.export.c99.node import Done, Node, NoForm
from models.export.c99.tensors import C_TYPES, Buffer, Tensor, scratch, suffix


class Inverse(OpRun):
    """The operator's own reference; ONNX, which it is no part of, has none."""

    op_domain = "com.microsoft"

    def _run(self, matrix: np.ndarray) -> tuple[np.ndarray]:
        return (np.linalg.inv(matrix),)


@dataclass(frozen=True)
class Inverted:
    """out = the inverse of the one matrix (..., n, n) that is given."""

    out: Tensor
    given: Tensor
    kind: str = "Inverse"

    @property
    def reads(self) -> list[Buffer]:
        """Buffers read."""
        return [self.given.buffer]

    @property
    def writes(self) -> Buffer:
        """The buffer written."""
        return self.out.buffer

    def code(self, place: Place) -> list[str]:
        """Lines of C."""
        n = self.out.shape[-1]
        array, first = place(self.out.buffer)
        number, f = C_TYPES[self.out.kind.name], suffix(self.out.kind)
        return [
            *Nest(self.kind, self.out, (self.given,), "{0}").code(place),
            "{",
            f"    {number} *a = {array} + {first}, s;",
            f"    int from[{n}];",
            f"    for (int k = 0; k < {n}; k++) {{",
            "        int p = k;",
            f"        for (int i = k + 1; i < {n}; i++)",
            f"            p = fabs{f}(a[{n} * i + k]) > fabs{f}(a[{n} * p + k]) ? i : p;",
            "        from[k] = p;",
            f"        for (int j = 0; j < {n}; j++)",
            f"            s = a[{n} * k + j], a[{n} * k + j] = a[{n} * p + j], a[{n} * p + j] = s;",
            f"        s = a[{n + 1} * k], a[{n + 1} * k] = 1;",
            f"        for (int j = 0; j < {n}; j++)",
            f"            a[{n} * k + j] /= s;",
            f"        for (int i = 0; i < {n}; i++) {{",
            "            if (i == k)",
            "                continue;",
            f"            s = a[{n} * i + k], a[{n} * i + k] = 0;",
            f"            for (int j = 0; j < {n}; j++)",
            f"                a[{n} * i + j] -= s * a[{n} * k + j];",
            "        }",
            "    }",
            f"    for (int k = {n - 1}; k >= 0; k--)",
            f"        for (int i = 0; i < {n}; i++)",
            f"            s = a[{n} * i + k], a[{n} * i + k] = a[{n} * i + from[k]], a[{n} * i + from[k]] = s;",
            "}",
        ]


def inverse(node: Node) -> Done:
    """Of one matrix."""
    given = node.tensor(0)
    *many, n, _ = given.shape
    if np.prod(many, dtype=int) != 1:
        raise NoForm("operator Inverse of several matrices")
    out = scratch((*many, n, n), given.kind)
    return [Inverted(out, given)], [out]
