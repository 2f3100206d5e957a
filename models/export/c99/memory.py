"""Lays out the arrays between operators in one static array a type; what is no longer read makes room for the next."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from softslide.models.export.c99.loops import Place
from softslide.models.export.c99.tensors import Buffer


class Statement(Protocol):
    """A step of the generated function."""

    @property
    def kind(self) -> str:
        """The operator it stands for."""

    @property
    def reads(self) -> Iterable[Buffer]:
        """Buffers read."""

    @property
    def writes(self) -> Buffer:
        """The buffer written."""

    def code(self, place: Place) -> list[str]:
        """Lines of C."""


def layout(statements: Sequence[Statement]) -> tuple[dict[Buffer, int], dict[np.dtype, int]]:
    """Each scratch buffer's first element in its type's array, and the arrays' sizes. Large ones choose first."""
    begins: dict[Buffer, int] = {}
    ends: dict[Buffer, int] = {}
    for n, statement in enumerate(statements):
        for buffer in (statement.writes, *statement.reads):
            if buffer.scratch:
                begins.setdefault(buffer, n)
                ends[buffer] = n
    offsets: dict[Buffer, int] = {}
    sizes: dict[np.dtype, int] = defaultdict(int)
    for buffer in sorted(begins, key=lambda b: -b.size):
        alive = [
            other
            for other in offsets
            if other.kind == buffer.kind and begins[other] <= ends[buffer] and begins[buffer] <= ends[other]
        ]
        offset = 0
        for other in sorted(alive, key=offsets.__getitem__):
            if offset + buffer.size <= offsets[other]:
                break
            offset = max(offset, offsets[other] + other.size)
        offsets[buffer] = offset
        sizes[buffer.kind] = max(sizes[buffer.kind], offset + buffer.size)
    return offsets, dict(sizes)
