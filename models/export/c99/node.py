"""One node of a graph, as the functions that make loops of it see it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from softslide.models.export.c99.memory import Statement
from softslide.models.export.c99.tensors import Tensor

# The steps of a node, and the tensors that they leave.
Done = tuple[list[Statement], list[Tensor]]


class NoForm(ValueError):
    """A node has no form in C."""


@dataclass(frozen=True)
class Node:
    """One node of a graph. run: ONNX's own reference of the operator, arrays in, arrays out."""

    kind: str
    inputs: list[Tensor | None]
    attributes: dict[str, Any]
    run: Callable[..., tuple[np.ndarray, ...]]

    def tensor(self, n: int) -> Tensor:
        """An input that has to be there."""
        found = self.inputs[n] if n < len(self.inputs) else None
        if found is None:
            raise NoForm(f"operator {self.kind} without input {n}")
        return found

    def argument(self, n: int, default: Any = None) -> Any:
        """An input that has to be a constant."""
        found = self.inputs[n] if n < len(self.inputs) else None
        if found is None:
            return default
        if found.value is None:
            raise NoForm(f"operator {self.kind} with a computed input {n}")
        return found.value
