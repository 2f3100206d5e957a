"""A forest as tables and one loop: each tree's nodes in preorder, so that the way to go on `true` needs no pointer."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from softslide.models.export.c99.loops import Nest, Place
from softslide.models.export.c99.tensors import Buffer, Tensor, constant

LEAF = -1
_Branch = tuple[bytes, int, float, int, int]  # mode, feature, bound, node on true, node on false


@dataclass(frozen=True)
class TreeTables:
    """A node n reads feature[n] and goes on to n + 1 if it is at most bound[n], else to n's tree's begin + other[n].

    Where feature[n] is LEAF, other[n] is the row in the tree's weights. start, leaves: each tree's first node and
    row. weights: (rows, targets). base: (targets,).
    """

    feature: Tensor
    bound: Tensor
    other: Tensor
    start: Tensor
    leaves: Tensor
    weights: Tensor
    base: Tensor

    @property
    def targets(self) -> int:
        """Numbers that a leaf holds."""
        return self.weights.shape[1]


@dataclass(frozen=True)
class TreeSum:
    """out (1, T) = base + the sum over trees of the leaves that x (1, F) falls into."""

    out: Tensor
    x: Tensor
    tables: TreeTables
    kind: str = "TreeEnsembleRegressor"

    @property
    def reads(self) -> list[Buffer]:
        """Buffers read."""
        return [self.x.buffer, *(tensor.buffer for tensor in vars(self.tables).values())]

    @property
    def writes(self) -> Buffer:
        """The buffer written."""
        return self.out.buffer

    def code(self, place: Place) -> list[str]:
        """Lines of C."""
        t = self.tables
        feature, bound, other, start, leaves, weights = (
            place(tensor.buffer)[0] for tensor in (t.feature, t.bound, t.other, t.start, t.leaves, t.weights)
        )
        x, first = place(self.x.buffer)
        out, begin = place(self.out.buffer)
        return [
            *Nest(self.kind, self.out, (t.base,), "{0}").code(place),
            f"for (int t = 0; t < {t.start.buffer.size}; t++) {{",
            f"    int32_t n = {start}[t];",
            f"    while ({feature}[n] >= 0)",
            f"        n = {x}[{first} + {feature}[n]] <= {bound}[n] ? n + 1 : {start}[t] + {other}[n];",
            f"    for (int k = 0; k < {t.targets}; k++)",
            f"        {out}[{begin} + k] += {weights}[{t.targets} * ({leaves}[t] + {other}[n]) + k];",
            "}",
        ]


def tree_tables(attributes: Mapping[str, Any]) -> TreeTables:
    """The tables of a TreeEnsembleRegressor node's attributes.

    Raises:
        ValueError: comparisons other than <=, missing values, averages or a transform.
    """
    if (
        set(attributes["nodes_modes"]) - {b"BRANCH_LEQ", b"LEAF"}
        or any(attributes.get("nodes_missing_value_tracks_true", ()))
        or attributes.get("post_transform", b"NONE") != b"NONE"
        or attributes.get("aggregate_function", b"SUM") != b"SUM"
    ):
        raise ValueError("more than sums of <= branches")
    targets = attributes["n_targets"]
    trees: dict[int, dict[int, _Branch]] = defaultdict(dict)
    for tree, node, *branch in _rows(
        attributes, "nodes", "treeids nodeids modes featureids values truenodeids falsenodeids"
    ):
        trees[tree][node] = tuple(branch)
    held: dict[int, dict[int, np.ndarray]] = defaultdict(
        lambda: defaultdict(lambda: np.zeros(targets, np.float32))
    )
    for tree, node, target, weight in _rows(attributes, "target", "treeids nodeids ids weights"):
        held[tree][node][target] += weight
    parts = [_preorder(nodes, held[tree]) for tree, nodes in trees.items()]
    feature, bound, other, weights = (np.concatenate([part[n] for part in parts]) for n in range(4))
    base = attributes.get("base_values") or [0.0] * targets
    return TreeTables(
        feature=_whole_numbers(feature),
        bound=constant(bound.astype(np.float32)),
        other=_whole_numbers(other),
        start=constant(np.cumsum([0, *(len(part[0]) for part in parts[:-1])]).astype(np.int32)),
        leaves=constant(np.cumsum([0, *(len(part[3]) for part in parts[:-1])]).astype(np.int32)),
        weights=constant(weights),
        base=constant(np.array(base, np.float32)),
    )


def _preorder(
    nodes: dict[int, _Branch], held: dict[int, np.ndarray]
) -> tuple[list[int], list[float], list[int], list[np.ndarray]]:
    """One tree's feature, bound, other and weights; held: the weights (T,) of its leaves."""
    feature: list[int] = []
    bound: list[float] = []
    other: list[int] = []
    weights: list[np.ndarray] = []
    # Every exporter lists the root first. Next to a node that waits: whose `other` it is, if anyone's.
    waiting: list[tuple[int, int | None]] = [(next(iter(nodes)), None)]
    while waiting:
        node, parent = waiting.pop()
        if parent is not None:
            other[parent] = len(feature)
        mode, column, value, yes, no = nodes[node]
        if mode == b"LEAF":
            other.append(len(weights))
            weights.append(held[node])
        else:
            waiting += [(no, len(feature)), (yes, None)]
            other.append(0)
        feature.append(LEAF if mode == b"LEAF" else column)
        bound.append(value)
    return feature, bound, other, weights


def _rows(attributes: Mapping[str, Any], prefix: str, names: str) -> Iterator[tuple]:
    return zip(*(attributes[f"{prefix}_{name}"] for name in names.split()), strict=True)


def _whole_numbers(values: np.ndarray) -> Tensor:
    """In the smallest signed type that holds them."""
    return constant(values.astype(np.min_scalar_type(-int(values.max()) - 1)))
