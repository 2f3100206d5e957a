"""Arrays of the generated code: flat C arrays, and tensors that say which of an array's elements they hold."""

from dataclasses import dataclass
from typing import Any

import numpy as np

C_TYPES = {
    "float32": "float",
    "float64": "double",
    "bool": "unsigned char",
    "int8": "int8_t",
    "int16": "int16_t",
    "int32": "int32_t",
    "int64": "int64_t",
}


@dataclass(frozen=True, eq=False)
class Buffer:
    """A C array of `size` elements of a numpy type. name: of a parameter; value: of a constant, flat."""

    kind: np.dtype
    size: int
    name: str = ""
    value: np.ndarray | None = None

    @property
    def scratch(self) -> bool:
        """Whether it is neither a parameter nor a constant."""
        return self.value is None and not self.name


@dataclass(frozen=True, eq=False)
class Tensor:
    """index: for each entry its place in the buffer, in even steps along every axis.

    An operator that only rearranges entries needs no code: the same buffer is read by another index.
    """

    buffer: Buffer
    index: np.ndarray

    @property
    def shape(self) -> tuple[int, ...]:
        """Sizes of the axes."""
        return self.index.shape

    @property
    def kind(self) -> np.dtype:
        """The element type."""
        return self.buffer.kind

    @property
    def value(self) -> np.ndarray | None:
        """A constant's entries, None of anything else."""
        return None if self.buffer.value is None else self.buffer.value[self.index]

    def seen(self, index: np.ndarray) -> "Tensor":
        """The same buffer by another index."""
        return Tensor(self.buffer, index)


def whole(buffer: Buffer, shape: tuple[int, ...]) -> Tensor:
    """All of a buffer, in order."""
    return Tensor(buffer, np.arange(buffer.size).reshape(shape))


def scratch(shape: tuple[int, ...], kind: np.dtype) -> Tensor:
    """A new array to work in."""
    return whole(Buffer(kind, int(np.prod(shape, dtype=int))), shape)


def constant(value: np.ndarray) -> Tensor:
    """A constant's tensor."""
    return whole(Buffer(value.dtype, value.size, value=value.ravel()), value.shape)


def literal(value: Any) -> str:
    """A numpy number that C reads to the last bit."""
    if value.dtype.kind != "f":
        return str(int(value))
    if not np.isfinite(value):
        return "NAN" if np.isnan(value) else f"{'-' if value < 0 else ''}INFINITY"
    return str(value) + suffix(value.dtype)


def suffix(kind: np.dtype) -> str:
    """What constants and the names of math.h end in for an element type."""
    return "f" if kind == np.float32 else ""
